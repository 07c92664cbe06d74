"""Test the studio as its user meets it: a server of its own process, driven in a browser."""

import asyncio
import http.client
import json
import re
import signal
import struct
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import numpy as np
import pytest
from pictures import png_chunk
from studio_pages import (
    after,
    fetched,
    fill,
    finished,
    frame,
    previewed,
    run,
    same_by,
    served,
    take,
    until,
)

from clmorph.studio import work
from clmorph.studio.routes import Studio
from clmorph.studio.tabs import Shown, Tab


def test_from_two_pictures_to_the_same_file_as_the_command(opened, pictures, place):
    page = opened()
    # One is dropped, the other one chosen.
    page.evaluate(
        """([bytes, name]) => { const data = new DataTransfer();
        data.items.add(new File([new Uint8Array(bytes)], name));
        document.dispatchEvent(new DragEvent("drop", { dataTransfer: data, bubbles: true })); }""",
        [list(pictures[0].read_bytes()), pictures[0].name],
    )
    until(page, "studio.state.pictures.length === 1")
    take(page, pictures[1:])
    previewed(page)
    before = frame(page, 0.5)
    # The preview follows a slider, and a pair of landmarks.
    after(page, lambda: page.get_by_label("Color weight, as a slider").fill("1"))
    heavier = frame(page, 0.5)
    assert heavier != before
    page.locator("#shown .frame").nth(0).click(position={"x": 30, "y": 40})
    other = page.locator("#shown .frame").nth(1)
    after(page, lambda: other.click(position={"x": 80, "y": 70}))
    assert len(page.evaluate("studio.landmarks.pairs()")) == 1
    assert frame(page, 0.5) != heavier
    # A long run is cancelled: the preview stays, and another run follows.
    fill(page, frames="2000", size="64")
    page.click("#run")
    until(page, "document.getElementById('status').textContent.startsWith('frames')")
    page.click("#cancel")
    until(page, "document.getElementById('status').textContent === 'cancelled'")
    until(page, "document.querySelectorAll('#views iframe:not(.previous)').length === 1")
    fill(page, frames="6", size="24")
    page.select_option("#option-reverse", "yes")
    run(page)
    assert page.evaluate("studio.state.view.contentWindow.clmorph.times.length") == 6
    assert frame(page, 0.2) != frame(page, 0.8)
    gif = fetched(page, "gif")
    assert same_by(page, "command", place / "command", pictures, "morph.gif") == gif
    recipe = json.loads(fetched(page, "json"))
    assert recipe["options"]["frames"] == 6
    assert [image["file"] for image in recipe["images"]] == [path.name for path in pictures]


@pytest.mark.full
def test_mistakes_are_the_lines_of_the_terminal(opened, pictures, place):
    page = opened()
    bad, huge = place / "bad.png", place / "huge.png"
    bad.write_bytes(b"not a picture")
    head = struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    data = b"\x89PNG\r\n\x1a\n" + png_chunk(b"IHDR", head) + png_chunk(b"IEND", b"")
    huge.write_bytes(data)
    for path in (bad, huge):
        page.set_input_files("#choose", str(path))
        until(page, f"document.getElementById('failure').textContent.includes('{path.name}')")
        shown = page.inner_text("#failure")
        said = subprocess.run(
            [sys.executable, "-m", "clmorph", "morph", path.name, path.name, "-o", "x.gif"],
            cwd=place, capture_output=True, text=True,
        ).stderr  # fmt: skip
        assert f"clmorph: {shown}" in said.splitlines()
    take(page, pictures)
    number = page.evaluate("studio.state.number")
    fill(page, blur="much")
    until(page, "!document.getElementById('failure').hidden")
    assert "Invalid value for '--blur'" in page.inner_text("#failure")
    # In this order, what is set is never right, however long a slow machine takes between both.
    fill(page, frames="1", blur="")
    until(page, "document.getElementById('failure').textContent.includes('--frames 1')")
    # The last preview has stayed.
    assert page.evaluate("studio.state.shown") == number


@pytest.mark.full
def test_tabs_keep_apart(opened, pictures):
    one = opened()
    two = opened(color_scheme="dark")
    take(one, pictures)
    take(two, pictures[::-1])
    assert one.evaluate("studio.state.tab") != two.evaluate("studio.state.tab")
    assert frame(one, 0.0) != frame(two, 0.0)
    for page, frames in ((one, "5"), (two, "4")):
        fill(page, size="24", frames=frames)
        page.click("#run")
    for page, frames in ((one, 5), (two, 4)):
        finished(page)
        assert page.evaluate("studio.state.view.contentWindow.clmorph.times.length") == frames
    # Each control has a name for those who do not see it.
    unnamed = one.evaluate(
        """[...document.querySelectorAll("button, input, select, textarea")]
        .filter((each) => !(each.labels?.length || each.ariaLabel || each.textContent.trim()))
        .map((each) => each.id)"""
    )
    assert unnamed == []


def asked(port, method, path, headers=(), body=None, host=None):
    """The status and the body of an answer to a request that no browser would send."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.putrequest(method, path, skip_host=True)
    connection.putheader("Host", host or f"127.0.0.1:{port}")
    for name, value in dict(headers).items():
        connection.putheader(name, value)
    if body is not None:
        connection.putheader("Content-Length", str(len(body)))
    connection.endheaders(body)
    answer = connection.getresponse()
    found = answer.status, answer.read(), dict(answer.getheaders())
    connection.close()
    return found


def test_an_older_request_does_not_replace_a_newer_one(place, monkeypatch):
    """The presets of the first request take longer to choose than those of the second."""
    jobs, seconds = [], iter((0.3, 0.0))

    def recognized(ask):
        time.sleep(next(seconds))
        return "photo"

    class Waiting:
        def submit(self, job, replaces):
            jobs.append(job.work.args[0].args[0].number)
            return 0

    async def begun():
        studio = Studio(place, Waiting(), str, [], [{"name": "auto", "label": "auto"}])
        tab = studio.tabs.open()
        pixels = np.zeros((4, 5, 3), np.float32)
        tab.pictures += [Shown(place / f"{key}.png", pixels, key) for key in "ab"]
        requests = []
        for body in (b'{"number": 1}', b'{"number": 2}'):

            async def stream(body=body):
                yield body

            requests.append(studio.start("preview", SimpleNamespace(stream=stream), tab))
        return await asyncio.gather(*requests)

    monkeypatch.setattr(work.Ask, "recognized", recognized)
    with ThreadPoolExecutor(1) as thread:  # the browser of other tests keeps a loop in this one
        answers = thread.submit(asyncio.run, begun()).result()
    assert [answer.status_code for answer in answers] == [202, 202]
    assert jobs == [1, 2]


def test_strangers_are_refused(port):
    status, body, headers = asked(port, "POST", "/tabs")
    tab = f"/tabs/{json.loads(body)['tab']}"
    assert status == 200
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert "access-control-allow-origin" not in {name.lower() for name in headers}
    evil = "evil.example", f"evil.example:{port}"
    for host in (*evil, f"127.0.0.1:{port + 1}", f"x@127.0.0.1:{port}"):
        assert asked(port, "GET", "/", host=host)[0] == 403, host
    for header in (
        {"Origin": "http://evil.example"}, {"Origin": "null"},
        {"Origin": f"http://localhost:{port}"}, {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "same-site"},
    ):  # fmt: skip
        for path in ("/tabs", f"{tab}/pictures", f"{tab}/events"):
            method = "GET" if path.endswith("events") else "POST"
            assert asked(port, method, path, header)[0] == 403, (header, path)
    for path in (
        "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/tabs/../studio.html",
        f"{tab}/views/..%2f..%2fowner", f"{tab}/views/%2fetc%2fpasswd", f"{tab}/pictures/..%2f..",
        f"{tab}/files/..%2fowner", f"{tab}/files/npz", "/tabs/nobody/events",
    ):  # fmt: skip
        assert asked(port, "GET", path)[0] == 404, path
    # Names of pictures cannot leave their folder, nor can the text of an option name a file.
    status, body, _ = asked(port, "POST", f"{tab}/pictures?name=..%2f..%2fx.png", body=b"junk")
    assert status == 400
    assert json.loads(body)["line"].startswith("error: x.png is not an image")
    files = {"landmark": "/etc/passwd.txt"}, {"landmarks": "/etc/passwd.csv"}
    for settings in (*files, [], {"blur": 1}):
        text = json.dumps({"number": 1, "settings": settings}).encode()
        assert asked(port, "POST", f"{tab}/preview", body=text)[0] == 400
    for text in (b"", b"[", b"[1]", b'{"number": 1e99}', b"[" * 100_000, b"x" * 300_000):
        assert asked(port, "POST", f"{tab}/run", body=text)[0] == 400
    # A file that is too large is refused before it is read.
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.putrequest("POST", f"{tab}/pictures?name=large.png")
    connection.putheader("Content-Length", str(10**10))
    connection.endheaders(b"\x89PNG")
    answer = connection.getresponse()
    assert answer.status == 413
    assert b"large.png: more than" in answer.read()
    connection.close()


def test_another_host_needs_the_token(tmp_path):
    with served(tmp_path / "tmp", "--host", "0.0.0.0") as (process, port):
        token = re.search(r"\?token=(\S+)", process.line)[1]
        assert asked(port, "GET", "/")[0] == 403
        assert asked(port, "GET", "/?token=wrong")[0] == 403
        assert asked(port, "POST", f"/tabs?token={token}")[0] == 403
        status, _, headers = asked(port, "GET", f"/?token={token}")
        assert status == 303
        cookie = headers["set-cookie"]
        assert "HttpOnly" in cookie
        assert "samesite=strict" in cookie.lower()
        given = {"Cookie": cookie.split(";")[0]}
        assert asked(port, "GET", "/", given)[0] == 200
        assert asked(port, "GET", "/", given, host=f"evil.example:{port}")[0] == 403


@pytest.mark.full
def test_nothing_is_left_at_the_end(tmp_path, pictures):
    tmp = tmp_path / "tmp"
    with served(tmp) as (process, port):
        tab = json.loads(asked(port, "POST", "/tabs")[1])["tab"]
        picture = pictures[0].read_bytes()
        assert asked(port, "POST", f"/tabs/{tab}/pictures?name=a.png", body=picture)[0] == 200
        assert len(list(tmp.rglob("a.png"))) == 1
        process.kill()
        process.wait(20)
    assert len(list(tmp.rglob("a.png"))) == 1
    with served(tmp) as (process, port):
        assert list(tmp.rglob("a.png")) == []
        tab = json.loads(asked(port, "POST", "/tabs")[1])["tab"]
        for name in ("a.png", "b.png"):
            asked(port, "POST", f"/tabs/{tab}/pictures?name={name}", body=picture)
        ask = {"number": 1, "settings": {"frames": "5000"}}
        assert asked(port, "POST", f"/tabs/{tab}/run", body=json.dumps(ask).encode())[0] == 202
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 128 + signal.SIGTERM
        assert "Traceback" not in process.stderr.read()
    assert list(tmp.iterdir()) == []


def test_names_of_pictures_differ_from_those_of_painted_regions(tmp_path):
    tab = Tab("key", tmp_path, None)
    for name, wanted in (
        ("a-mask.png", "a-mask-2.png"), ("a-labels.jpg", "a-labels-2.jpg"),
        ("mask.png", "mask.png"), ("unlabels.png", "unlabels.png"), ("morph.png", "morph-2.png"),
    ):  # fmt: skip
        assert tab.place(name).name == wanted
