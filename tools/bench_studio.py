"""Measure how fast the studio answers, in headless Chromium: ``python tools/bench_studio.py``.

Starts ``clmorph studio``, takes the bundled pictures, and prints a Markdown table: seconds from a
change of a slider to the first preview on the screen and to the finest one, from a click on Cancel
to the page's word and to the end of the work. Then it solves the problem of a first preview from
scratch, and from the potentials of another color weight. Needs the extras "studio" and "test", and
Chromium.
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import clmorph
from clmorph.cli.studio import write_samples
from clmorph.images.pixels import fit, read_image
from clmorph.pipeline.presets import DRAFT_TOL
from clmorph.studio.making import MORPH_STEPS

WEIGHTS = (0.1, 0.9, 0.3, 0.7, 0.2, 0.8, 0.4, 0.6)
MOMENTS = (0.3, 0.8, 1.5, 2.5)


def wait(page: Any, condition: str) -> float:
    """Return the seconds until a condition holds on the page."""
    began = time.perf_counter()
    while not page.evaluate(f"Boolean({condition})"):
        time.sleep(0.005)
    return time.perf_counter() - began


def measure(page: Any) -> dict[str, list[float]]:
    found: dict[str, list[float]] = {name: [] for name in ("first", "finest", "answer", "done")}
    page.evaluate("studio.ready")
    page.click("#samples")
    wait(page, "document.getElementById('status').textContent === 'preview'")
    slider = page.get_by_label("Color weight, as a slider")
    for weight in WEIGHTS:
        number = page.evaluate("studio.state.number")
        slider.fill(str(weight))
        first = wait(page, f"studio.state.shown > {number}")
        found["first"].append(first)
        finest = "studio.state.view.contentWindow.clmorph.times.length >= 12"
        found["finest"].append(first + wait(page, finest))
        time.sleep(0.3)
    page.fill("#option-frames", "300")
    for moment in MOMENTS:
        page.click("#run")
        time.sleep(moment)
        began = time.perf_counter()
        with page.expect_response("**/cancel"):
            page.click("#cancel")
        found["answer"].append(time.perf_counter() - began)
        wait(page, "document.getElementById('status').textContent === 'cancelled'")
        found["done"].append(time.perf_counter() - began)
    return found


def solves(device: str) -> list[str]:
    """Time solves of the size of a first preview, from scratch and from other potentials."""
    operations = clmorph.get_backend(device)
    side, tol = MORPH_STEPS[0][0], DRAFT_TOL
    with tempfile.TemporaryDirectory() as folder:
        pictures = [fit(read_image(path), side) for path in write_samples(Path(folder))]
    before, problem = (
        [clmorph.lift(picture, weight) for picture in pictures] for weight in (0.5, 0.6)
    )
    options: dict[str, Any] = {"blur": 0.04, "reach": 0.3, "tol": tol, "backend": operations}
    start = clmorph.sinkhorn(*before, **options)
    lines = []
    for words, more in (("from scratch", {}), ("from other potentials", {"start": start})):
        seconds = []
        for _ in range(7):
            began = time.perf_counter()
            found = clmorph.sinkhorn(*problem, **options, **more)
            seconds.append(time.perf_counter() - began)
        middle = statistics.median(seconds)
        lines.append(f"a solve {words}: {middle:.3f} s, {found.n_iter} iterations")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--picture", help="write a picture of the page to this file")
    arguments = parser.parse_args()
    from playwright.sync_api import sync_playwright

    command = [sys.executable, "-m", "clmorph", "studio", "--port", "0", "--no-browser"]
    command += ["--backend", arguments.device]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    assert server.stderr is not None
    try:
        address = re.search(r"http://\S+", server.stderr.readline())
        assert address is not None
        with sync_playwright() as driver:
            path = shutil.which("chromium") or shutil.which("google-chrome")
            browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
            page = browser.new_page(
                viewport={"width": 1280, "height": 1000}, reduced_motion="reduce"
            )
            page.goto(address[0])
            found = measure(page)
            if arguments.picture:
                # A whole morph, halfway, beside a plain cross-fade.
                page.fill("#option-frames", "30")
                page.click("#run")
                wait(page, "!document.getElementById('downloads').hidden")
                page.evaluate("studio.state.view.contentWindow.clmorph.seek(0.5)")
                page.select_option("#over", "fade")
                time.sleep(0.5)
                page.screenshot(path=arguments.picture)
            browser.close()
    finally:
        server.terminate()
        server.wait()
    meanings = {
        "first": "a slider's change to the first preview",
        "finest": "a slider's change to the finest preview",
        "answer": "Cancel to the server's answer",
        "done": "Cancel to the end of the work",
    }
    print("| from … to | median, s | longest, s |\n|---|---|---|")
    for name, values in found.items():
        print(f"| {meanings[name]} | {statistics.median(values):.2f} | {max(values):.2f} |")
    print("", *solves(arguments.device), sep="\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
