import numpy as np
import pytest
from PIL import Image

from clmorph import OutputError
from clmorph.export import GIF_SIDE, output_writer, save, to_bytes


@pytest.fixture
def frames(rng):
    """A canvas that grows from 6 x 8 to 12 x 16."""
    sizes = [(6, 8), (8, 10), (10, 13), (12, 16)]
    return [rng.random((*size, 3)).astype(np.float32) for size in sizes]


TIMES = np.linspace(0, 1, 4)


def test_folder_holds_the_frames_exactly(tmp_path, frames):
    save(frames, TIMES, tmp_path / "out")
    files = sorted((tmp_path / "out").iterdir())
    assert [file.name for file in files] == [f"frame-{i:04d}.png" for i in range(4)]
    for file, frame in zip(files, frames, strict=True):
        with Image.open(file) as picture:
            assert np.array_equal(np.asarray(picture), to_bytes(frame))
    assert list(tmp_path.iterdir()) == [tmp_path / "out"]


def test_gif(tmp_path, frames):
    save(frames, TIMES, tmp_path / "out.gif")
    with Image.open(tmp_path / "out.gif") as gif:
        assert gif.n_frames == 4
        assert gif.size == (GIF_SIDE, GIF_SIDE * 3 // 4)
        assert gif.info["loop"] == 0
        for number in (0, 3):
            gif.seek(number)
            enlarged = np.asarray(gif.convert("RGB").resize((16, 12), Image.Resampling.BOX))
            assert enlarged.shape == (12, 16, 3)
        assert np.abs(enlarged.astype(float) - to_bytes(frames[3])).mean() < 25
    assert list(tmp_path.iterdir()) == [tmp_path / "out.gif"]


def test_constant_frames_keep_their_color(tmp_path):
    frames = [np.full((5, 5, 3), value) for value in (0.2, 0.8)]
    save(frames, TIMES[:2], tmp_path / "out.gif")
    with Image.open(tmp_path / "out.gif") as gif:
        for number, value in enumerate((0.2, 0.8)):
            gif.seek(number)
            assert np.abs(np.asarray(gif.convert("RGB")) / 255 - value).max() < 0.01


def test_contact_sheet(tmp_path, frames):
    save(frames, TIMES, tmp_path / "sheet.PNG")
    with Image.open(tmp_path / "sheet.PNG") as sheet:
        assert sheet.width > 4 * 192
        assert sheet.height > 144


def test_overwriting_a_file_and_filling_an_empty_folder(tmp_path, frames):
    (tmp_path / "out.gif").write_text("old")
    save(frames, TIMES, tmp_path / "out.gif")
    assert (tmp_path / "out.gif").read_bytes()[:3] == b"GIF"
    (tmp_path / "out").mkdir()
    save(frames, TIMES, tmp_path / "out")
    assert len(list((tmp_path / "out").iterdir())) == 4


def test_refusals(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a.png").write_text("")
    (tmp_path / "dir.gif").mkdir()
    for name, words in [
        ("out.bmp", "ending"),
        ("no/where/out.gif", "no folder"),
        ("file", "exists already"),
        ("full", "exists already"),
        ("dir.gif", "is a folder"),
        ("file/out.gif", "no folder"),
        ("x" * 300 + ".gif", "cannot be written"),
    ]:
        with pytest.raises(OutputError, match=words) as caught:
            output_writer(tmp_path / name)
        assert "\n" not in str(caught.value)


def test_a_failed_write_leaves_nothing(tmp_path, frames, monkeypatch):
    def full(*args, **options):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    for name in ("out.gif", "sheet.png", "folder"):
        with pytest.raises(OutputError, match="No space left"):
            save(frames, TIMES, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_impossible_places():
    for place in ("/proc/x.gif", "/sys/x.png", "/proc/frames"):
        with pytest.raises(OutputError) as caught:
            output_writer(place)
        assert "\n" not in str(caught.value)
    for nothing in (None, "", 3):
        with pytest.raises(OutputError, match="path"):
            output_writer(nothing)


def test_shapes_are_kept_on_a_common_canvas(tmp_path):
    """A wide frame among tall ones gets bars, and is not stretched."""
    save([np.ones((4, 16, 3)), np.ones((16, 4, 3))], TIMES[:2], tmp_path / "out.gif")
    with Image.open(tmp_path / "out.gif") as gif:
        wide = np.asarray(gif.convert("L"))
        assert gif.size == (GIF_SIDE, GIF_SIDE)
    assert wide[GIF_SIDE // 2].min() > 250
    assert wide[: GIF_SIDE // 4].max() < 5
