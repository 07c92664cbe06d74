"""Compile kernels for graphics cards, and compare registers and memory with a table of limits.

    python tools/kernel_limits.py [--renew]

Nothing is run: clang 19 compiles the build that cards get, with ``stand_ins.cl`` in place of their
vendors' libraries, and ptxas goes on for NVIDIA's. For each kernel ``kernel_limits.toml`` has the
most registers of a work-item, bytes of it that are spilled or lie in memory, and bytes of local
memory of a work-group, of all variants. The exit code is 1 where a kernel passes its limits, or has
none. ``--renew`` writes the table: registers in steps of 8, because compilers differ by a few.

The table also has what the innermost loops of the dense log-sum-exp take for a pair of points, by
which its speed is bounded: slots, which are instructions on NVIDIA's cards and vector instructions
on AMD's, without and with a running maximum (the first loop is over tiles that cannot raise it),
and words that are read from local memory.

ptxas and nvdisasm come with CUDA, and in the wheels nvidia-cuda-nvcc-cu12 and nvidia-cuda-nvdisasm.
"""

import re
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from clmorph import cl_kernels
from clmorph.backends.opencl.build.constants import gpu_constants
from clmorph.backends.opencl.build.program import build_options
from clmorph.backends.opencl.build.variants import Variant, all_variants

TABLE = Path(__file__).with_suffix(".toml")
FOLDER = Path(cl_kernels.__file__).parent
NVIDIA, AMD = ("sm_80", "sm_90"), ("gfx90a", "gfx1100")
TARGETS = (*NVIDIA, *AMD)
CLANG = [
    "clang-19", "-x", "cl", "-Xclang", "-finclude-default-header", "-include",
    str(Path(__file__).with_name("stand_ins.cl")), "-O3", "-S",
]  # fmt: skip
#: The option by which denormals are flushed, and clang's own for NVIDIA's cards.
FLUSHED = {"-cl-denorms-are-zero": ("-Xclang", "-fdenormal-fp-math-f32=preserve-sign")}
#: What ptxas says of each kernel, in its order, and what the metadata of AMD's assembly say.
PTXAS = re.compile(
    r"entry function '(\w+)'.*?(\d+) bytes stack frame, (\d+) bytes spill stores.*?"
    r"Used (\d+) registers(?:.*?(\d+) bytes smem)?", re.DOTALL,
)  # fmt: skip
METADATA = re.compile(
    r"\.group_segment_fixed_size: (\d+).*?\.name: +(\w+).*?\.private_segment_fixed_size: (\d+).*?"
    r"\.vgpr_count: +(\d+)", re.DOTALL,
)  # fmt: skip

#: Instructions for powers of two.
POWERS = "MUFU.EX2", "v_exp_f32"
#: Reads of local memory, with the bits of each; 32 by default.
LOCAL_READS = re.compile(r"(?:LDS|ds_(?:read|load)_b)\.?(\d*)\b")
#: The variant whose slots are counted.
DENSE = Variant("log_sum_exp.cl", 5)
#: What `slots` counts.
LOOP_WORDS = "slots below the maximum", "slots with a running maximum", "words from local memory"
#: Registers, bytes spilled or in memory, and bytes of local memory.
Numbers = tuple[int, int, int]


def measure(target: str, variant: Variant) -> dict[str, Numbers]:
    """Return the numbers of the kernels of a variant, by name."""
    text, said = _compiled(target, variant)
    if target in NVIDIA:
        # Local memory may be missing, so that each kernel's part is searched alone.
        return {
            name: (int(registers), int(stack) + int(spilled), int(local or 0))
            for each in re.split(r"(?=ptxas info +: Compiling entry)", said)
            for name, stack, spilled, registers, local in PTXAS.findall(each)
        }
    return {
        name: (int(registers), int(private), int(local))
        for local, name, private, registers in METADATA.findall(text)
    }


def slots(target: str) -> tuple[float, float, float]:
    """Return what `DENSE` takes for a pair of points.

    It is slots without and with the running maximum, and the most words from local memory.
    """
    constants = gpu_constants(256)
    rows = constants.width * DENSE.stacks(constants)
    found, words = [], 0.0
    for loop, rescaled in zip(innermost(_compiled(target, DENSE, True)[0]), (0, 1), strict=True):
        powers = sum(power in line for line in loop for power in POWERS)
        # Beside a power for each pair there is one for each row, by which its sum is rescaled.
        rounds, rest = divmod(powers, rows * (constants.unroll + rescaled))
        assert (rounds > 0, rest) == (True, 0), f"{target}: {powers} powers in an innermost loop"
        counted = loop if target in NVIDIA else [line for line in loop if line.startswith("v_")]
        pairs = rounds * rows * constants.unroll
        found.append(len(counted) / pairs)
        reads = [int(bits or 32) for line in loop for bits in LOCAL_READS.findall(line)]
        words = max(words, sum(reads) / 32 / pairs)
    return found[0], found[1], words


def innermost(text: str) -> list[list[str]]:
    """Return the instructions of the two shortest loops that have powers of two."""
    lines: list[str] = []
    labels: dict[str, int] = {}
    loops: list[list[str]] = []
    for line in text.splitlines():
        if label := re.match(r"\s*(\.L\w+):", line):
            labels[label[1]] = len(lines)
        elif found := re.match(r"\s+/\*[0-9a-f]{4,}\*/\s+(.*?);|\t([a-z]\w*_.*)", line):
            lines.append(found[1] or found[2])
            branch = re.match(r"(?:@\S+ )?(?:BRA|s_c?branch).*?(\.L\w+)", lines[-1])
            if branch and branch[1] in labels:
                loops.append(lines[labels[branch[1]] :])
    return sorted(
        (loop for loop in loops if any(p in line for line in loop for p in POWERS)), key=len
    )[:2]


def _compiled(target: str, variant: Variant, disassembled: bool = False) -> tuple[str, str]:
    """Return the assembly of a variant, or the machine's code as text, and what ptxas says."""
    options = build_options(variant.macros(gpu_constants(256)))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "kernels.s"
        if target in NVIDIA:
            own = ["-target", "nvptx64-nvidia-cuda", f"-march={target}"]
            # For these targets clang knows the option by another name.
            options = [each for option in options for each in FLUSHED.get(option, (option,))]
        else:
            own = ["-target", "amdgcn-amd-amdhsa", "-nogpulib", f"-mcpu={target}"]
        _run([*CLANG, *own, *options, "-o", str(file), str(FOLDER / variant.file)])
        if target in NVIDIA:
            said = _run(["ptxas", "-v", f"-arch={target}", "-o", f"{file}.bin", str(file)])
            return (_run(["nvdisasm", "-c", f"{file}.bin"]) if disassembled else ""), said
        return file.read_text(), ""


def _run(command: list[str]) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}:\n{done.stderr}")
    return done.stdout + done.stderr


def measure_all(variants: tuple[Variant, ...]) -> dict[str, dict[str, Numbers]]:
    """Return the largest numbers of each kernel, "file:kernel", over variants, by target."""
    pairs = [(target, variant) for target in TARGETS for variant in variants]
    with ThreadPoolExecutor() as pool:
        made = pool.map(lambda pair: measure(*pair), pairs)
    found: dict[str, dict[str, Numbers]] = {target: {} for target in TARGETS}
    for (target, variant), numbers in zip(pairs, made, strict=True):
        assert numbers, f"no numbers of {variant} for {target}"
        for kernel, own in numbers.items():
            name = f"{variant.file}:{kernel}"
            found[target][name] = tuple(map(max, own, found[target].get(name, own)))
    return found


def complaints(
    found: dict[str, dict[str, Numbers]], limits: dict[str, dict[str, list[int]]]
) -> list[str]:
    """Return in sentences which kernels pass their limits, or have none."""
    words = "registers", "bytes spilled or in memory", "bytes of local memory"
    said = []
    for target, kernels in found.items():
        for name, numbers in kernels.items():
            most = limits.get(target, {}).get(name)
            if most is None:
                said.append(f"{target}: {name} has no limits")
                continue
            said += [
                f"{target}: {name} takes {number} {word}; the limit is {limit}"
                for number, limit, word in zip(numbers, most, words, strict=True)
                if number > limit
            ]
    return said


def main() -> int:
    found = measure_all(all_variants())
    of_loop = {target: slots(target) for target in TARGETS}
    if "--renew" in sys.argv[1:]:
        lines = [
            "[slots]",
            *(
                f"{target} = [{below:.2f}, {running:.2f}, {words:.2f}]"
                for target, (below, running, words) in of_loop.items()
            ),
        ]
        for target, kernels in found.items():
            lines.append(f"\n[{target}]")
            for name, (registers, spilled, local) in sorted(kernels.items()):
                lines.append(f'"{name}" = [{-(-registers // 8) * 8}, {spilled}, {local}]')
        TABLE.write_text("\n".join(lines).lstrip() + "\n")
        return 0
    limits = tomllib.loads(TABLE.read_text())
    most = limits.pop("slots")
    said = complaints(found, limits)
    said += [
        f"{target}: {DENSE} takes {n:.2f} {word} a pair; the limit is {limit}"
        for target, found in of_loop.items()
        for word, n, limit in zip(LOOP_WORDS, found, most[target], strict=True)
        if n > limit + 0.05
    ]
    print("\n".join(said) or f"{sum(map(len, found.values()))} kernels are within their limits")
    if said:
        print("limits that must change are renewed by: python tools/kernel_limits.py --renew")
    return 1 if said else 0


if __name__ == "__main__":
    raise SystemExit(main())
