"""Kernels compile, without a warning, for other targets than the devices that are present.

Nothing is run: clang checks OpenCL C 1.2 and generates code for 32 and 64 bits of address.
"""

import functools
import subprocess
from dataclasses import replace
from pathlib import Path

import pyopencl as cl
import pytest
from programs import program

from clmorph import cl_kernels
from clmorph.backends.opencl.build.constants import (
    SLICED_FROM,
    cpu_constants,
    gpu_constants,
    lanes_constants,
)
from clmorph.backends.opencl.build.program import build_options, source
from clmorph.backends.opencl.build.variants import KERNELS, all_variants

FOLDER = Path(cl_kernels.__file__).parent

#: Targets, and what clang needs to know of each beside its name. Those of graphics cards come
#: without the library of their vendor, which only linking needs.
TARGETS = {
    "spir64": [],
    "spir": [],
    "amdgcn-amd-amdhsa": ["-nogpulib", "-mcpu=gfx906"],
    "nvptx64-nvidia-cuda": [],
    "x86_64-linux-gnu": [],
}
BUILDS = {
    "scalar-1": gpu_constants(1),
    "scalar-64-pairs": replace(gpu_constants(64), precise=1),
    "scalar-256": replace(gpu_constants(256), group=256, tile=256),
    "lanes": lanes_constants(64),
    "lanes-pairs": replace(lanes_constants(64), precise=1),
    "vector-4": cpu_constants(4),
    "vector-8-pairs": replace(cpu_constants(8), precise=1),
    "vector-16": cpu_constants(16),
}
#: Arguments of a launch that all kernels over rows share are not needed by each; vectors wider
#: than registers are inlined, see common.cl.
WARNINGS = ["-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter"]
HEADER = ["-Xclang", "-finclude-default-header", "-Xclang", "-fdeclare-opencl-builtins"]


#: Each file in each way in which it is built, some of them also for points of many coordinates.
VARIANTS = [
    *all_variants(),
    *(variant for variant in all_variants(SLICED_FROM)[::3] if variant.dimension),
]


def compiled(clang, target, *options):
    """Let clang compile a file, or nothing, and return the process that has ended."""
    command = [clang, "-x", "cl", "-target", target, *TARGETS[target], "-S", "-emit-llvm"]
    command += ["-o", "-", *options]
    return subprocess.run(command, input="", capture_output=True, text=True, check=False)


@functools.cache
def has_target(clang, target):
    """Return whether a compiler has a target, as Apple's has not; clang 19 must have all."""
    done = compiled(clang, target, "-")
    assert done.returncode == 0 or Path(clang).name != "clang-19", done.stderr
    return done.returncode == 0


@pytest.mark.parametrize("build", BUILDS)
@pytest.mark.parametrize("file", KERNELS)
def test_every_kernel_compiles_without_a_warning(file, build):
    """Each file in each build, each time for the next target, so that it is for all of them.

    By default each file is in one build.
    """
    clang = program("clang")
    place = list(KERNELS).index(file) + list(BUILDS).index(build)
    target = list(TARGETS)[place % len(TARGETS)]
    if not has_target(clang, target):
        pytest.skip(f"{clang} has no target {target}")
    for variant in (each for each in VARIANTS if each.file == file):
        given = [
            f"-D{name}={f'{value:.9g}f' if isinstance(value, float) else value}"
            for name, value in variant.macros(BUILDS[build]).items()
        ]
        options = "-cl-std=CL1.2", *HEADER, *WARNINGS, *given, "-O0"
        done = compiled(clang, target, *options, str(FOLDER / file))
        assert not done.stderr, f"{variant}:\n{done.stderr}"
        assert "define" in done.stdout


@pytest.mark.full
@pytest.mark.small
@pytest.mark.filterwarnings("ignore::pyopencl.CompilerWarning")  # Intel's log of success
def test_drivers_build_without_a_warning(each_device):
    """Users' builds are without -Werror: a warning of a driver's own must not refuse a device.

    One variant of each file: tests of operations build the others, and warnings are errors there.
    """
    suited = [each for each in VARIANTS if each.suits(each_device.constants)]
    for variant in {each.file: each for each in suited}.values():
        options = build_options(variant.macros(each_device.constants))
        program = cl.Program(each_device.context, source(variant.file))
        program.build([*options, "-Werror"], cache_dir=False)
