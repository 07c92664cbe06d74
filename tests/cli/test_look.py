"""Tables of colors that the command writes, read by FFmpeg."""

import subprocess
import sys

import av
import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from clmorph.cli.main import cli


def picture(path, seed):
    y, x = np.mgrid[:48, :48] / 47
    tint = np.random.default_rng(seed).uniform(0.4, 1.0, 3)
    values = np.stack([x, y, 0.5 * (x + 1 - y)], axis=2) * tint
    Image.fromarray(np.rint(255 * values).astype(np.uint8)).save(path)
    return str(path)


@pytest.mark.parametrize("size", [17, 33, 65])
def test_ffmpeg_applies_the_table_as_we_do(tmp_path, size):
    a, b = picture(tmp_path / "a.png", 0), picture(tmp_path / "b.png", 1)
    out, look = tmp_path / "out.png", tmp_path / "look.cube"
    run = CliRunner().invoke(
        cli,
        ["recolor", a, b, "-o", str(out), "--export-lut", str(look), "--lut-size", str(size),
         "--backend", "numpy"],
        catch_exceptions=False,
    )  # fmt: skip
    assert run.exit_code == 0, run.output
    frame = av.VideoFrame.from_ndarray(np.asarray(Image.open(a)), format="rgb24")
    graph = av.filter.Graph()
    source = graph.add_buffer(width=48, height=48, format="rgb24", time_base=1)
    table, sink = graph.add("lut3d", f"file={look}"), graph.add("buffersink")
    source.link_to(table)
    table.link_to(sink)
    graph.configure()
    graph.push(frame)
    found = graph.pull().to_ndarray(format="rgb24").astype(float)
    want = np.asarray(Image.open(out)).astype(float)
    assert np.abs(found - want).mean() <= 1.0
    assert np.abs(want - np.asarray(Image.open(a))).mean() > 5.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["--export-lut", "look.lut"], "expected .cube"),
        (["--lut-size", "17"], "expected --export-lut"),
        (["--export-lut", "look.cube", "--lut-size", "16"], "16"),
    ],
)
def test_mistakes_leave_an_old_output(tmp_path, monkeypatch, given, words):
    monkeypatch.chdir(tmp_path)
    a, b = picture(tmp_path / "a.png", 0), picture(tmp_path / "b.png", 1)
    out = tmp_path / "out.png"
    out.write_bytes(b"old")
    command = [sys.executable, "-m", "clmorph", "recolor", a, b, "-o", str(out), *given]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 2
    assert words in run.stderr
    assert "Traceback" not in run.stderr
    assert out.read_bytes() == b"old"
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "b.png", "out.png"}
