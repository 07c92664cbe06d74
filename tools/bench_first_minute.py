"""Time what a newcomer does first: ``python tools/bench_first_minute.py``.

Runs whole commands as processes of their own: ``clmorph demo`` with empty caches and with full
ones, morphs of two photographs, two drawings and two sprites of 32 x 32 pixels with the defaults,
and a first look (``--draft``). The commands take turns, `--rounds` times. The table shows the
fastest and the slowest whole command in seconds of wall clock, and for the fastest the seconds of
each stage as ``--json`` prints them. ``--device`` names the device.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from drawn_pictures import logo
from PIL import Image
from rich.progress import track

ROOT = Path(__file__).resolve().parents[1]
SPRITES = [ROOT / f"clmorph/cli/samples/{name}.png" for name in ("cat", "toadstool")]


def pictures(folder: Path) -> dict[str, list[str]]:
    """Write pairs of pictures into a folder, and return their paths by name."""
    from skimage import data

    arrays = {
        "photographs": (data.astronaut(), data.chelsea()),
        "drawings": [np.rint(255 * logo(name, 256)) for name in ("star", "shapes")],
        "sprites": [np.asarray(Image.open(file)) for file in SPRITES],
    }
    found = {}
    for name, pair in arrays.items():
        found[name] = [str(folder / f"{name}-{number}.png") for number in range(2)]
        for path, pixels in zip(found[name], pair, strict=True):
            Image.fromarray(np.asarray(pixels, np.uint8)).save(path)
    return found


def timed(arguments: list[str], folder: Path, cache: Path) -> tuple[float, dict[str, float]]:
    """Run a command; return its seconds, and those of its stages if it prints them."""
    environment = {name: value for name, value in os.environ.items() if "PYTHON" not in name}
    environment["XDG_CACHE_HOME"] = str(cache)
    command = [sys.executable, "-P", "-m", "clmorph", *arguments]
    began = time.perf_counter()
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - began
    if done.returncode:
        raise SystemExit(done.stderr.strip())
    stages = json.loads(done.stdout)["seconds"] if "--json" in arguments else {}
    return seconds, stages


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--rounds", type=int, default=3)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        pairs = pictures(folder)
        cases: dict[str, list[str]] = {"demo, empty caches": ["demo"], "demo": ["demo"]}
        for kind, pair in pairs.items():
            cases[f"two {kind}"] = ["morph", *pair, "-o", "out.gif", "--json"]
        draft = ["morph", *pairs["photographs"], "-o", "out.gif", "--json", "--draft"]
        cases["two photographs, --draft"] = draft
        found: dict[str, list[tuple[float, dict[str, float]]]] = {case: [] for case in cases}
        for turn in track(range(given.rounds), "rounds"):
            for case, arguments in cases.items():
                cache = folder / ("full" if "empty" not in case else f"empty-{turn}")
                if turn == 0 and cache.name == "full":
                    timed([*arguments, "--device", given.device], folder, cache)
                found[case].append(timed([*arguments, "--device", given.device], folder, cache))
    print("| command | fastest | slowest | stages of the fastest |")
    print("|---|---|---|---|")
    for case, results in found.items():
        seconds, stages = min(results, key=lambda result: result[0])
        told = ", ".join(
            f"{stage.replace('write out.gif', 'file')} {value:.2f}"
            for stage, value in stages.items()
            if stage != "total"
        )
        if stages:
            told += f" (imports and the rest {seconds - stages['total']:.2f})"
        slowest = max(result[0] for result in results)
        print(f"| {case} | {seconds:.2f} s | {slowest:.2f} s | {told} |")


if __name__ == "__main__":
    main()
