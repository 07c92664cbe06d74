"""Record what clmorph computes, to the bit, and compare a later state of the code with the record.

A change that moves or renames code must not change results. ``make`` writes the digests of
frames, potentials, plans and files for a list of option sets and for each backend that is named;
``compare`` computes them again and lists every difference. Both must run on the same machine, with
the same drivers and the same tuning record. Files are compared by what they show (pixels,
durations, arrays): their metadata hold the version.

    python tools/golden_record.py make golden.json --device numpy --device 0:0 --device 2:0
    python tools/golden_record.py compare golden.json
"""

import argparse
import json
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import golden_cases as cases


def record(backend: str) -> dict[str, Any]:
    """Return the record of one backend, computed in this process."""
    warnings.simplefilter("ignore")
    found: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        cases.pictures(folder)
        for part in (cases.calls, cases.commands):
            found |= dict(part(backend, folder))
    return json.loads(json.dumps(found))


def differences(old: Any, new: Any, place: str) -> Iterator[str]:
    """Name every place where two records differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for name in {**old, **new}:
            if name not in new or name not in old:
                yield f"{place} / {name}: only in {'the old' if name in old else 'the new'} record"
            else:
                yield from differences(old[name], new[name], f"{place} / {name}")
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for index, (one, other) in enumerate(zip(old, new, strict=True)):
            yield from differences(one, other, f"{place} [{index}]")
    elif old != new:
        yield f"{place}: {old} became {new}"


def main() -> int:
    """Make a record, or compare with one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("task", choices=("make", "compare", "one"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--device", action="append", help="Such as numpy or 0:0; repeatable.")
    options = parser.parse_args()
    if options.task == "one":
        options.file.write_text(json.dumps(record(options.device[0]), indent=1), "utf-8")
        return 0
    known = json.loads(options.file.read_text("utf-8")) if options.task == "compare" else {}
    found: dict[str, Any] = {}
    for backend in options.device or list(known) or ["numpy", "auto"]:
        # Each runs in a separate process, as for a user.
        with tempfile.TemporaryDirectory() as folder:
            part = Path(folder) / "part.json"
            command = [sys.executable, __file__, "one", str(part), "--device", backend]
            if subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode:
                print(f"{backend}: failed", file=sys.stderr)
                return 2
            found[backend] = json.loads(part.read_text("utf-8"))
    if options.task == "make":
        options.file.write_text(json.dumps(found, indent=1), "utf-8")
        print(f"{options.file}: {sum(map(len, found.values()))} records")
        return 0
    lines = [
        line for backend in found for line in differences(known[backend], found[backend], backend)
    ]
    print("\n".join(lines) or f"the same: {sum(map(len, found.values()))} records")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
