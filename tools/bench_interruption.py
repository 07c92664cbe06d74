"""Measure how long Ctrl-C takes, and what it leaves: ``python tools/bench_interruption.py A B``.

Runs ``clmorph morph A B`` again and again, interrupts it at other moments, and prints a Markdown
table; ends with 1 if a run left a file, a traceback, or another exit code than 130.
"""

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

MOMENTS = (0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 11.0)


def interrupted(command: list[str], moment: float) -> tuple[float, int, list[str], str]:
    """Return seconds until it ended, its exit code, what it left, and its last words."""
    with tempfile.TemporaryDirectory() as folder:
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        time.sleep(moment)
        process.send_signal(signal.SIGINT)
        began = time.perf_counter()
        _, told = process.communicate()
        seconds = time.perf_counter() - began
        left = sorted(path.name for path in Path(folder).iterdir())
    return seconds, process.returncode, left, told


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("a", type=Path)
    parser.add_argument("b", type=Path)
    parser.add_argument("--output", default="out.mp4")
    arguments = parser.parse_args()
    command = [sys.executable, "-m", "clmorph", "morph", str(arguments.a.resolve())]
    command += [str(arguments.b.resolve()), "-o", arguments.output]
    print("| interrupted after, s | ended within, s | exit code | files left |\n|---|---|---|---|")
    bad = 0
    for moment in MOMENTS:
        seconds, code, left, told = interrupted(command, moment)
        print(f"| {moment:g} | {seconds:.2f} | {code} | {', '.join(left) or 'none'} |", flush=True)
        done = code == 0 and left == [arguments.output]
        bad += not done and (code != 130 or bool(left) or "Traceback" in told)
    return min(bad, 1)


if __name__ == "__main__":
    raise SystemExit(main())
