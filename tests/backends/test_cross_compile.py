"""Kernels compile, without a warning, for other targets than the devices that are present.

Nothing is run: clang checks OpenCL C 1.2 and generates code for 32 and 64 bits of address.
"""

import itertools
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from programs import program

import clmorph.cl_kernels
from clmorph.backends.opencl.build.constants import cpu_constants, gpu_constants, lanes_constants

FOLDER = Path(clmorph.cl_kernels.__file__).parent

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


def macros(constants):
    """Yield each file with the macros of each of its builds."""
    yield "particles.cl", constants.particle_macros()
    yield "splat.cl", constants.splat_macros()
    yield "gauss_transform.cl", constants.gauss_transform_macros()
    yield "sliced_ellpack.cl", constants.sliced_ellpack_macros()
    yield (
        "near_field.cl",
        constants.row_macros(5, listed=True) | constants.near_field_macros(),
    )
    for precise, listed in itertools.product((False, True), repeat=2):
        made = constants.row_macros(5, precise, listed)
        for file in ("log_sum_exp.cl", "plan_rows.cl", "plan_shares.cl"):
            yield file, made
    yield "log_sum_exp.cl", constants.row_macros(6, True, False, True)


def complaints(clang, target, file, defines, *options):
    """Return what clang says about a file."""
    given = [
        f"-D{name}={f'{value:.9g}f' if isinstance(value, float) else value}"
        for name, value in defines.items()
    ]
    command = [
        clang, "-x", "cl", "-cl-std=CL1.2", "-target", target, *TARGETS[target], *HEADER,
        *WARNINGS, *given, *options, "-S", "-emit-llvm", "-O0", "-o", "-", str(file),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        assert "define" in done.stdout
    return done.stderr


@pytest.mark.parametrize("build", BUILDS)
@pytest.mark.parametrize("target", TARGETS)
def test_every_kernel_compiles_without_a_warning(target, build):
    clang = program("clang")
    for file, defines in macros(BUILDS[build]):
        said = complaints(clang, target, FOLDER / file, defines)
        assert not said, f"{file} {defines}:\n{said}"


def test_a_warning_is_noticed(tmp_path):
    """Such as what OpenCL C 1.2 lacks, and an index of a wrong type."""
    clang = program("clang")
    for text in (
        "__kernel void k(__global int* p) { p[0] = sub_group_all(1); }",
        "__kernel void k(__global int* p) { float x = 1.0f; p[0] = 1; }",
        "__kernel void k(const size_t n, __global int* p) { p[0] = (int)n; }",
    ):
        (tmp_path / "wrong.cl").write_text(text)
        assert complaints(clang, "spir64", tmp_path / "wrong.cl", {})
