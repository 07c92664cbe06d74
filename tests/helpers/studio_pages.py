"""The studio in a browser, for the tests: a server of its own process, pages, what users do."""

import os
import re
import shlex
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest
from browsers import watched
from PIL import Image


@contextmanager
def served(tmp, *arguments):
    """Start the studio with a folder for temporary files; yield its process and port."""
    tmp.mkdir(exist_ok=True)
    process = subprocess.Popen(
        [sys.executable, "-m", "clmorph", "studio", "--port", "0", "--no-browser", *arguments],
        stderr=subprocess.PIPE, text=True, env=os.environ | {"TMPDIR": str(tmp)},
    )  # fmt: skip
    try:
        line = process.stderr.readline()
        process.line = line
        found = re.search(r"http://\S+?:(\d+)/", line)
        assert found, line + process.stderr.read()
        yield process, int(found[1])
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("studio")


@pytest.fixture(scope="module")
def port(place):
    with served(place / "tmp") as (_, port):
        yield port


@pytest.fixture
def opened(browser, port):
    """Open pages; each must be without errors, and ask nobody but the studio."""
    with watched(browser) as (open_page, bad):

        def opened_page(**options):
            address = f"http://127.0.0.1:{port}/"
            options = {"viewport": {"width": 1280, "height": 900}} | options
            page = open_page(address, [address], **options)
            page.evaluate("studio.ready")
            return page

        yield opened_page
    # The browser says of each refusal that it is one.
    refused = [text for text in bad if not text.startswith("Failed to load resource")]
    assert refused == [], refused


@pytest.fixture(scope="module")
def pictures(place):
    """Two drawn pictures in a folder, one of them with a name that shells take apart."""
    rng = np.random.default_rng(1)
    paths = []
    for name, shape, color in (("a one's.png", (48, 60), 0), ("b.png", (56, 44), 2)):
        pixels = np.full((*shape, 3), 200, np.uint8)
        pixels[10:30, 8:28] = 40
        pixels[10:30, 8:28, color] = 250
        pixels += rng.integers(0, 6, pixels.shape, dtype=np.uint8)
        Image.fromarray(pixels).save(place / name)
        paths.append(place / name)
    return paths


@pytest.fixture
def page(opened, pictures):
    """A page that has the pictures."""
    page = opened()
    take(page, pictures)
    return page


def until(page, condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not page.evaluate(f"Boolean({condition})"):
        if time.monotonic() > end:
            numbers = page.evaluate("[studio.state.number, studio.state.shown, studio.state.heard]")
            said = page.inner_text("#status"), page.inner_text("#failure")
            raise AssertionError(f"{condition}: asked, shown, heard {numbers}, said {said}")
        time.sleep(0.02)


def take(page, paths):
    """Give pictures, and wait for the first preview of all of them."""
    count = page.evaluate("studio.state.pictures.length") + len(paths)
    page.set_input_files("#choose", [str(path) for path in paths])
    until(page, f"studio.state.pictures.length === {count}")
    until(
        page,
        "studio.state.shown === studio.state.number "
        "&& studio.state.asks.get(studio.state.shown)?.pictures "
        "=== studio.state.pictures.map((each) => each.key).join()",
    )


def fill(page, **values):
    """Set options; those that are folded away are unfolded."""
    page.evaluate("document.getElementById('more').open = true")
    for name, value in values.items():
        page.fill(f"#option-{name}", value)


def frame(page, time):
    """The pixels of the viewer's frame at a time, as a digest.

    Nothing finer may come meanwhile: a viewer that is removed while it decodes never answers.
    """
    return page.evaluate(
        """async (time) => { const view = studio.state.view.contentWindow;
        await view.clmorph.seek(time);
        return view.document.getElementById("canvas").toDataURL(); }""",
        time,
    )


def run(page):
    page.click("#run")
    finished(page)


def finished(page):
    until(page, "!document.getElementById('downloads').hidden")
    # The answer to the request, with the command, can come after the result.
    until(page, "studio.state.shown === studio.state.number")
    until(page, "studio.state.told === studio.state.number")


def fetched(page, ending):
    with page.expect_download() as found:
        page.click(f"#get-{ending}")
    return found.value.path().read_bytes()


def previewed(page):
    """Wait until the finest preview stands there, and its command."""
    until(
        page,
        "studio.state.shown === studio.state.number && studio.state.shown > 0 "
        "&& studio.state.coming === null && studio.state.told === studio.state.number "
        "&& document.getElementById('status').textContent === 'preview'",
    )


def after(page, action):
    """Do something that changes a preview, and wait for the last one."""
    number = page.evaluate("studio.state.number")
    action()
    until(page, f"studio.state.number > {number}")
    previewed(page)


def same_by(page, which, folder, pictures, output, painted=()):
    """Run the copied command or Python code in a folder with some files; return what it writes."""
    folder.mkdir()
    for data, name in (*((path.read_bytes(), path.name) for path in pictures), *painted):
        (folder / name).write_bytes(data)
    text = page.input_value(f"#{which}")
    if which == "python":
        command = [sys.executable, "-c", text]
    else:
        words = shlex.split(text)
        assert words[0] == "clmorph"
        command = [sys.executable, "-m", *words]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return (folder / output).read_bytes()
