"""Label images from files: gray levels, indices of a palette, colors, and what is refused."""

import numpy as np
import pytest
import tifffile
from PIL import Image

import clmorph
from clmorph import InputError
from clmorph.images.label_maps import COLORED, label_text, owners, reduced_values

LABELS = np.array([[0, 1, 2], [200, 1, 255]])


def test_the_same_labels_from_every_kind_of_file(tmp_path):
    gray = Image.fromarray(LABELS.astype(np.uint8))
    palette = Image.fromarray(LABELS.astype(np.uint8), "P")
    palette.putpalette(np.random.default_rng(0).integers(0, 255, 768, np.uint8).tobytes())
    files = {
        "gray.png": gray, "palette.png": palette, "color.png": gray.convert("RGB"),
        "opaque.png": gray.convert("RGBA"), "level.tif": gray, "lossless.bmp": gray,
        "deep.png": Image.fromarray(LABELS.astype(np.uint16)),
    }  # fmt: skip
    for name, picture in files.items():
        picture.save(tmp_path / name)
        found = clmorph.read_labels(tmp_path / name)
        assert found.dtype == np.int64
        assert np.array_equal(found, LABELS), name
    for kind in (np.uint8, np.int64, ">i4", bool):
        np.save(tmp_path / "a.npy", LABELS.astype(kind))
        assert np.array_equal(clmorph.read_labels(tmp_path / "a.npy"), LABELS.astype(kind))
    Image.fromarray(LABELS == 1).save(tmp_path / "mask.png")
    assert clmorph.read_labels(tmp_path / "mask.png").tolist() == (LABELS == 1).tolist()
    deep = Image.fromarray(np.array([[0, 40000]], np.uint16))
    deep.save(tmp_path / "deep.png")
    assert clmorph.read_labels(tmp_path / "deep.png").tolist() == [[0, 40000]]


@pytest.mark.parametrize("dtype", ["u1", "u2", "i4", ">i4", "u8", "i8"])
def test_labels_of_tiffs(tmp_path, dtype, capfd):
    file = tmp_path / "a.tif"
    order = ">" if dtype.startswith(">") else "<"
    tifffile.imwrite(file, LABELS.astype(dtype), compression="lzw", byteorder=order, metadata=None)
    assert np.array_equal(clmorph.read_labels(file), LABELS)
    clear = np.full((2, 3, 2), 255, np.uint8)
    clear[..., 0] = LABELS
    tifffile.imwrite(file, clear, photometric="minisblack", extrasamples=["unassalpha"])
    assert np.array_equal(clmorph.read_labels(file), LABELS)
    clear[0, 0, 1] = 7
    tifffile.imwrite(file, clear, photometric="minisblack", extrasamples=["unassalpha"])
    with pytest.raises(InputError, match="transparent in parts"):
        clmorph.read_labels(file)
    Image.linear_gradient("L").save(file, compression="tiff_lzw")
    data = file.read_bytes()
    file.write_bytes(data[:9] + b"\xff" * 200 + data[209:])
    with pytest.raises(InputError, match="labels cannot be read"):
        clmorph.read_labels(file)
    assert capfd.readouterr() == ("", "")


def test_a_color_is_a_label(tmp_path):
    colors = np.array([[[255, 128, 0], [0, 0, 0], [9, 9, 9]]], np.uint8)
    Image.fromarray(colors).save(tmp_path / "a.png")
    found = clmorph.read_labels(tmp_path / "a.png")
    assert found.tolist() == [[COLORED + 0xFF8000, 0, 9]]
    assert label_text(int(found[0, 0])) == "#ff8000"


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.npy", None, "labels cannot be read"),
        ("a.png", None, "labels cannot be read"),
        ("a.png", b"nothing", "is not an image"),
        ("a.png", Image.new("RGBA", (2, 2), (1, 2, 3, 4)), "transparent in parts"),
        ("a.png", Image.fromarray(np.arange(1200, dtype=np.uint16).reshape(4, 300)),
         "has 1200 different labels: expected at most 256"),
        ("a.png", Image.new("L", (2000, 2000)), "expected at most 1000000"),
        ("a.npy", np.ones((2, 2)), "float64 of shape"),
        ("a.npy", np.ones((2, 2, 2), int), "array of shape"),
        ("a.npy", np.array([[{}]]), "Python objects"),
        ("a.npy", np.ones((0, 2), int), "of shape"),
        ("a.npy", b"\x93NUMPY\x01\x00v\x00{'descr': '<i8', 'fortran_order': False, "
         b"'shape': (1000, 999), }".ljust(128), "shorter than its header says"),
    ],
)  # fmt: skip
def test_label_files_that_cannot_be_used(tmp_path, name, content, told):
    file = tmp_path / name
    if isinstance(content, bytes):
        file.write_bytes(content)
    elif isinstance(content, np.ndarray):
        np.save(file, content)
    elif content is not None:
        content.save(file)
    with pytest.raises(InputError, match=told):
        clmorph.read_labels(file, max_pixels=1_000_000)


def test_pixels_and_their_owners():
    assert owners((4, 6), (2, 3)).tolist() == [[0, 0, 1, 1, 2, 2]] * 2 + [[3, 3, 4, 4, 5, 5]] * 2
    assert owners((3, 1), (3, 1)).tolist() == [[0], [1], [2]]
    for side in range(1, 60):
        for small in range(1, side + 1):
            counts = np.bincount(owners((side, 1), (small, 1)).ravel(), minlength=small)
            assert counts.min() >= side // small
            assert len(counts) == small
    values = np.arange(24.0).reshape(4, 6, 1)
    assert reduced_values(values, (2, 3)).ravel().tolist() == [3.5, 5.5, 7.5, 15.5, 17.5, 19.5]
    assert reduced_values(values, (4, 6)) is values
