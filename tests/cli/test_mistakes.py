"""What users get wrong: each answer is one line that names the value and the remedy, the
exit code is 2, and nothing is written. In the library: our exceptions, the same words.
"""

import contextlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import clmorph
import clmorph.analysis.metrics
from clmorph.backends.opencl import host_program

NUMBERS = {
    "--frames": ["0", "1", "-3", "2.5", "nan", "inf", "1e9", "many", "1000000000"],
    "--size": ["0", "1", "-5", "7.5", "nan", "huge", "100000000"],
    "--max-pixels": ["0", "-1", "1", "lots", "99999999999999999"],
    "--blur": ["0", "-0.1", "nan", "inf", "1e9", "1e-9", "soft"],
    "--reach": ["0", "-1", "nan", "-inf", "1e9", "far"],
    "--epsilon": ["0", "-0.1", "nan", "inf", "1e30", "1e-30", "soft"],
    "--rho": ["0", "-1", "nan", "-inf", "1e30", "far"],
    "--tol": ["0", "-1", "nan", "inf", "1e9", "tight"],
    "--max-iter": ["0", "-1", "2.5", "nan", "inf", "10000000000", "many"],
    "--color-weight": ["-1", "nan", "inf", "1e9", "red"],
    "--sigma-start": ["0", "-1", "nan", "inf", "1e9", "wide"],
    "--sigma-end": ["0", "-1", "nan", "inf", "1e9", "narrow"],
    "--gamma": ["-1", "nan", "inf", "1e9", "g"],
    "--color-space": ["hsv"],
    "--path-space": ["rgb"],
    "--mass": ["heavy", "alpha"],
    "--splatting": ["big"],
    "--sigma": ["1.2", "best"],
    "--endpoints": ["loose"],
    "--unmatched": ["stay"],
    "--extent": ["square"],
    "--sample": ["0", "-1", "1e9", "few"],
    "--seed": ["-1", "luck"],
    "--solve-size": ["0", "1", "2.5", "nan", "small"],
    "--max-particles": ["0", "-1", "nan", "few"],
    "--max-memory": ["0", "-1", "nan", "inf", "much"],
    "--log-threshold": ["nan", "inf", "-1e9", "low", "0"],
    "--fps": ["0", "-1", "nan", "inf", "1000", "fast"],
    "--duration": ["0", "-1", "nan", "inf", "1e9", "long"],
    "--hold": ["-1", "nan", "inf", "1e9", "long"],
}
FILES = [
    ("missing.png b.jpg -o x.gif", "missing.png: no such file"),
    (". b.jpg -o x.gif", "is not a file"),
    ("a.png full -o x.gif", "full is not a file"),
    ("empty.png b.jpg -o x.gif", "not an image"),
    ("text.png b.jpg -o x.gif", "not an image"),
    ("cut.png b.jpg -o x.gif", "cannot be decoded"),
    ("cut.jpg b.jpg -o x.gif", "cannot be decoded"),
    ("cut.tif b.jpg -o x.gif", "cannot be decoded"),
    ("vast.png b.jpg -o x.gif", "--max-pixels"),
    ("negative.tif b.jpg -o x.gif", "expected [0, 1]"),
    ("nan.tif b.jpg -o x.gif", "NaN"),
]
OUTPUTS = [
    ("a.png b.jpg -o x.mp3", "unknown ending '.mp3'"),
    ("a.png b.jpg -o .gif", "a name is missing before the ending, as in film.gif"),
    ("a.png b.jpg -o x.jpeg", "expected .gif, .webp"),
    ("a.png b.jpg -o no/x.gif", "no folder"),
    ("a.png b.jpg -o a.png/x.gif", "no folder"),
    ("a.png b.jpg -o full", "exists already"),
    ("a.png b.jpg -o full.gif", "is a folder"),
    ("a.png b.jpg -o plain", "exists already"),
]
OPTIONS = [
    ("a.png b.jpg", "expected -o"),
    ("a.png -o x.gif", "1 picture given"),
    ("-o x.gif", "no pictures given"),
    ("a.png b.jpg missing.png -o x.gif", "missing.png: no such file"),
    ("a.png b.jpg -o x.gif --format mov", "--format"),
    ("a.png b.jpg -o x.gif --canvas 0x9", "--canvas '0x9'"),
    ("a.png b.jpg -o x.gif --canvas wide", "--canvas 'wide'"),
    ("a.png b.jpg -o x.gif --background mauvish", "--background 'mauvish'"),
    ("a.png b.jpg -o x.gif --scaling best", "--scaling"),
    ("a.png b.jpg -o x.gif --ease bounce", "--ease"),
    ("a.png b.jpg -o x.gif --loop twice", "--loop"),
    ("a.png b.jpg -o x.gif --fps 10 --duration 9", "contradict"),
    ("a.png b.jpg -o x.gif --duration 1 --hold 2", "no longer than the holds"),
    ("a.png b.jpg -o x.gif --config text.png", "cannot be read"),
    ("a.png b.jpg -o x.gif --preset lovely", "--preset"),
    ("a.png b.jpg -o x.gif --colour 3", "--colour"),
    ("a.png b.jpg -o x.gif --blur", "--blur"),
    ("a.png b.jpg -o x.gif --device pocl --backend numpy", "contradict"),
    ("a.png b.jpg -o x.gif --device numpy --backend opencl", "contradict"),
    ("a.png b.jpg -o x.gif --blur 0.05 --epsilon 0.0025", "--blur 0.05 and --epsilon 0.0025"),
    ("a.png b.jpg -o x.gif --reach 0.3 --rho 0.09", "--reach 0.3 and --rho 0.09"),
    ("a.png b.jpg -o x.gif --reach balanced --rho 0.09", "--reach balanced and --rho 0.09"),
    ("a.png b.jpg -o x.gif --sigma-start AUTO", "or 'auto'"),
    ("a.png b.jpg -o x.gif --solve-size 1", "or 'none'"),
    ("a.png b.jpg -o x.gif --log-threshold -99999", "or 'relative'"),
    ("a.png b.jpg -o x.gif --max-memory 0", "gigabytes"),
    ("a.png b.jpg -o x.gif --barycentric --sample 2", "--barycentric contradict"),
    ("a.png b.jpg -o x.gif --reach 0.3,0.3,0.3", "a pair"),
    ("a.png b.jpg -o x.gif --reach 0.3,far", "far"),
    ("a.png b.jpg -o x.gif --blur 1e-6", "too small for points"),
    ("a.png b.jpg -o x.gif --gamma 1 --splatting local", "--gamma 1 belongs to adaptive"),
    ("a.png b.jpg -o x.gif --sigma optimal --splatting none", "--sigma"),
    ("a.png b.jpg -o x.gif --sigma optimal --reach 0.3,balanced", "one reach"),
    ("a.png b.jpg -o x.gif --log-threshold -13 --sample 2", "--log-threshold -13 and --sample 2"),
    ("a.png b.jpg -o x.gif --log-threshold -13 --barycentric", "of the whole plan"),
    ("a.png b.jpg -o x.gif --log-threshold -7", "can exceed it, log pi is below -7.6"),
    ("a.png b.jpg -o x.gif --log-threshold -7.61", "no pair of the plan exceeds it"),
]
#: What is said where there are devices, but not this one.
DEVICES = [
    ("a.png b.jpg -o x.gif --device warp-drive", "warp-drive"),
    ("a.png b.jpg -o x.gif --backend warp-drive", "warp-drive"),
    ("a.png b.jpg -o x.gif --device 9:9", "9:9"),
]
CASES = FILES + OUTPUTS + OPTIONS
CASES += [
    (f"a.png b.jpg -o x.gif {option} {value}", "")
    for option, values in NUMBERS.items()
    for value in values
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two good images, and files and folders that are not."""
    import tifffile

    folder = tmp_path_factory.mktemp("mistakes")
    rng = np.random.default_rng(0)
    noise = Image.fromarray(rng.integers(0, 255, (40, 50, 3), np.uint8))
    noise.save(folder / "a.png")
    noise.save(folder / "b.jpg")
    tifffile.imwrite(folder / "c.tif", rng.random((40, 50)).astype(np.float32))
    for name, whole, size in (
        ("cut.png", "a.png", 900), ("cut.jpg", "b.jpg", 700), ("cut.tif", "c.tif", 100),
    ):  # fmt: skip
        (folder / name).write_bytes((folder / whole).read_bytes()[:size])
    tifffile.imwrite(folder / "negative.tif", -np.ones((4, 4), np.float32))
    tifffile.imwrite(folder / "nan.tif", np.full((4, 4), np.nan, np.float32))
    (folder / "empty.png").write_bytes(b"")
    (folder / "text.png").write_text("a text with a picture's name")
    (folder / "plain").write_text("")
    Image.new("1", (20000, 20000)).save(folder / "vast.png")
    for name in ("full", "full.gif"):
        (folder / name).mkdir()
        (folder / name / "thing").write_text("")
    return folder


@pytest.mark.parametrize(
    ("arguments", "words"),
    [*CASES, *(pytest.param(*case, marks=pytest.mark.needs_device) for case in DEVICES)],
)
def test_one_line(folder, monkeypatch, refused, arguments, words):
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    told = refused("morph", *arguments.split())
    if words:
        assert words in told
    else:
        option, value = arguments.split()[-2:]
        written = {value}
        with contextlib.suppress(ValueError):
            written.add(repr(float(value)))
        assert any(text in told for text in written) or option == "--max-pixels"
        assert option in told or option[2:].replace("-", "_") in told or "n_frames" in told
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        ({"CLMORPH_DEVICE": "warp-drive"}, "warp-drive"),
        ({"CLMORPH_DEVICE": "7:7"}, "7:7"),
        ({"CLMORPH_QUIRKS": "grumpy"}, "grumpy"),
        ({"PYOPENCL_CTX": "77"}, "PYOPENCL_CTX"),
    ],
)
@pytest.mark.needs_device
def test_the_environment(folder, monkeypatch, refused, environment, words):
    clmorph.backends.select._named_backend.cache_clear()
    host_program.opened.cache_clear()
    monkeypatch.delenv("CLMORPH_DEVICE", raising=False)
    monkeypatch.chdir(folder)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert words in refused("morph", "a.png", "b.jpg", "-o", "x.gif", "--frames", "2")
    assert not Path("x.gif").exists()


SMALL = np.zeros((3, 4, 3))
#: Within the limits, but not within float32's.
FAR = np.ones(64), 1e4 * np.random.default_rng(0).random((64, 5))
LIBRARY = [
    (lambda: clmorph.lift(np.zeros(3)), "shape"),
    (lambda: clmorph.lift(np.zeros((3, 3, 2))), "shape"),
    (lambda: clmorph.lift(np.zeros((3, 3, 5))), "shape"),
    (lambda: clmorph.lift(np.zeros((0, 3, 3))), "shape"),
    (lambda: clmorph.lift(np.zeros((3, 3, 3), np.int64)), "dtype"),
    (lambda: clmorph.lift(np.zeros((3, 3), "U3")), "dtype"),
    (lambda: clmorph.lift(np.full((3, 3), np.nan)), "NaN"),
    (lambda: clmorph.lift(np.full((3, 3), -np.inf)), "infinity"),
    (lambda: clmorph.lift(np.full((3, 3), 255.0)), r"\[0, 1\]"),
    (lambda: clmorph.lift("a.png"), "read_image"),
    (lambda: clmorph.lift(None), "shape"),
    (lambda: clmorph.lift(SMALL, "heavy"), "color_weight"),
    (lambda: clmorph.lift(SMALL, weights=np.zeros((3, 4))), "positive sum"),
    (lambda: clmorph.lift(SMALL, weights=np.ones((4, 3))), "weights have shape"),
    (lambda: clmorph.morph(SMALL, SMALL, 1, backend="numpy"), "n_frames"),
    (lambda: clmorph.morph(SMALL, SMALL, backend="numpy", blur=True), "blur"),
    (lambda: clmorph.morph(SMALL, SMALL, backend="numpy", reach=(0.1, 0.2, 0.3)), "a pair"),
    (lambda: clmorph.morph(SMALL, SMALL, blur=0.1, epsilon=0.01), "give one of them"),
    (lambda: clmorph.morph(SMALL, SMALL, reach=None, rho=0.01), "give one of them"),
    (lambda: clmorph.morph(SMALL, SMALL, epsilon="x"), "epsilon='x'"),
    (lambda: clmorph.morph(SMALL, SMALL, rho=-4), "rho=-4"),
    pytest.param(
        lambda: clmorph.morph(SMALL, SMALL, backend="warp-drive"), "warp-drive",
        marks=pytest.mark.needs_device,
    ),
    (lambda: clmorph.morph(SMALL, SMALL, backend=7), "backend"),
    (lambda: clmorph.fit(SMALL, 1), "size"),
    (lambda: clmorph.fit([[1, 2], [3, 4]], 2), "dtype"),
    (lambda: clmorph.lift([[1, 2], [3]]), "differ in length"),
    (lambda: clmorph.morph(SMALL, SMALL, color_metric=[[1, 2], [3]]), "differ in length"),
    (lambda: clmorph.morph(SMALL, SMALL, weights=("x", None)), "not an array of numbers"),
    (lambda: clmorph.morph(SMALL, SMALL, sigma_start="2.5"), "sigma_start='2.5'"),
    (lambda: clmorph.morph(SMALL, SMALL, sigma_end=1e-20), "sigma_end=1e-20"),
    (lambda: clmorph.morph(SMALL, SMALL, n_frames="5"), "n_frames='5'"),
    (lambda: clmorph.morph(SMALL, SMALL, sigma_start="AUTO"), "or 'auto'"),
    (lambda: clmorph.morph(SMALL, SMALL, solve_size="none"), "or None"),
    (lambda: clmorph.morph(SMALL, SMALL, splatting=SMALL), "splatting=an array"),
    (lambda: clmorph.morph(SMALL, SMALL, device="0:0"), "--device or --backend"),
    (lambda: clmorph.MorphOptions().replace(preset="paper"), "preset"),
    (lambda: clmorph.reference.morph(SMALL, SMALL, sigma_start="auto"), "sigma_start='auto'"),
    (lambda: clmorph.analysis.metrics.step_sizes([]), "0 frames"),
    (lambda: clmorph.analysis.metrics.sharpness(np.zeros((3, 3))), "shape"),
    (lambda: clmorph.analysis.metrics.hole_fraction("x"), "not an array"),
    pytest.param(
        lambda: clmorph.sinkhorn(FAR, FAR, 0.03), "too small for .* on this device: .*'numpy'",
        marks=pytest.mark.needs_device,
    ),
    (lambda: clmorph.read_image("missing.png"), "no such file"),
    (lambda: clmorph.read_image("a.png", max_pixels=0), "max_pixels"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), LIBRARY)
def test_the_library(call, words):
    with pytest.raises(clmorph.ClmorphError, match=words) as caught:
        call()
    assert isinstance(caught.value, (ValueError, RuntimeError))
