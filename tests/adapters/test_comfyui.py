"""The nodes for ComfyUI, loaded and run by a stand-in for its loader and its executor."""

import subprocess
import sys
import tomllib
import types
from pathlib import Path

import comfyui_stand_in as comfyui
import numpy as np
import pytest

import clmorph
from clmorph import InputError
from clmorph.adapters.comfyui import NODE_CLASS_MAPPINGS, NODE_DISPLAY_NAME_MAPPINGS
from clmorph.adapters.comfyui.install import LINE
from clmorph.cli.main import main

COMMON = {"size": 0, "device": "numpy"}
QUICK = "blur = 0.2\nlandmark = 'none'"


class Tensor:
    """What the nodes use of PyTorch's tensors, where PyTorch is not installed."""

    def __init__(self, array):
        self.array = np.asarray(array)

    shape = property(lambda self: self.array.shape)
    dtype = property(lambda self: self.array.dtype)
    detach = cpu = lambda self: self

    def float(self):
        return Tensor(self.array.astype(np.float32))

    def numpy(self):
        return self.array


@pytest.fixture(autouse=True)
def torch(monkeypatch):
    """PyTorch, or what of it the nodes use."""
    try:
        import torch
    except ImportError:
        torch = types.ModuleType("torch")
        torch.from_numpy = Tensor
        monkeypatch.setitem(sys.modules, "torch", torch)
    return torch


class Pictures:
    """A node that gives some pictures, and counts what it is asked for."""

    RETURN_TYPES = ("IMAGE", "MASK", "IMAGE")
    OUTPUT_IS_LIST = (False, False, True)
    FUNCTION, CATEGORY = "run", "test"
    images = masks = several = None

    @classmethod
    def INPUT_TYPES(cls):  # noqa: N802
        return {"required": {"seed": ("INT", {"default": 0})}}

    def run(self, seed):
        return self.images, self.masks, self.several


@pytest.fixture
def graph(tmp_path, monkeypatch):
    """A graph whose nodes are loaded from the folder that the command writes."""
    folder = comfyui.make_folder(tmp_path / "ComfyUI")
    assert main(["comfyui", str(folder)]) == 0
    comfyui.install(monkeypatch)
    classes, _ = comfyui.load(folder)
    return comfyui.Graph(classes | {"Pictures": Pictures})


def batch(torch, rng, *shape):
    return torch.from_numpy(rng.random(shape).astype(np.float32))


def squares(torch, count=1, shift=0):
    """A batch of pictures of a square before a ground."""
    images = np.full((count, 10, 12, 3), 0.9, np.float32)
    for number in range(count):
        images[number, 2:6, 2 + shift + number : 6 + shift + number] = [0.8, 0.2, 0.1]
    return torch.from_numpy(images)


MORPH = {"frames": 3, "time": 0.5, "ease": "linear", "preset": "photo", "options": QUICK, **COMMON}
#: From the first picture to the list of pictures of the node "p", and mixes of both.
FILM = {"source": ("p", 0), "target": ("p", 2), **MORPH}
WEIGHTS = dict.fromkeys(("weight_a", "weight_b", "weight_c", "weight_d"), 1.0)
MIX = {"image_a": ("p", 0), "image_b": ("p", 2), "grid": 3, "preset": "photo", **WEIGHTS, **COMMON}


def asked(graph, name, given, seed=0):
    """Run a node after the node "p", which is run again for another seed; return its outputs."""
    plan = {"p": ("Pictures", {"seed": seed}), "n": (f"Clmorph{name}", given)}
    return graph.run(plan, "n")


@pytest.mark.parametrize("name", sorted(NODE_CLASS_MAPPINGS))
def test_the_contract(name):
    comfyui.check_class(NODE_CLASS_MAPPINGS[name])
    assert NODE_DISPLAY_NAME_MAPPINGS[name]


def test_nothing_heavy_is_imported():
    """ComfyUI loads all nodes at its start; those of clmorph need no driver for that."""
    code = (
        "import sys, clmorph.adapters.comfyui as c;"
        "[kind.INPUT_TYPES() for kind in c.NODE_CLASS_MAPPINGS.values()];"
        "assert not {'torch', 'pyopencl', 'comfy', 'av'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_folder(tmp_path, refused):
    """One file of one line; again it is written as it was; other folders are refused."""
    folder = comfyui.make_folder(tmp_path / "ComfyUI")
    for _ in range(2):
        assert main(["comfyui", str(folder)]) == 0
        (made,) = (folder / "custom_nodes").iterdir()
        assert [path.name for path in made.iterdir()] == ["__init__.py"]
        assert (made / "__init__.py").read_text().count("\n") == 1
    classes, names = comfyui.load(folder)
    assert set(classes) == set(names) == set(NODE_CLASS_MAPPINGS)
    (made / "other.py").write_text("")
    (made / "__init__.py").write_text("mine")
    for place, words in (
        (tmp_path, "is not a folder of ComfyUI (it has no custom_nodes, nodes.py, comfy)"),
        (folder / "custom_nodes", "is not a folder of ComfyUI"),
        (tmp_path / "missing", "is not a folder of ComfyUI"),
        (folder, "was not written by this command"),
    ):
        assert words in refused("comfyui", place)
    assert (made / "__init__.py").read_text() == "mine"


def test_the_entry_of_the_registry():
    folder = Path(__file__).parents[2] / "tools/comfyui"
    assert (folder / "__init__.py").read_text() == LINE
    entry = tomllib.loads((folder / "pyproject.toml").read_text())
    assert entry["project"]["version"] == clmorph.__version__
    assert entry["project"]["dependencies"] == ["clmorph"]
    assert (folder / "requirements.txt").read_text() == "clmorph\n"
    assert set(entry["tool"]["comfy"]) == {"PublisherId", "DisplayName"}


def test_a_film(graph, torch):
    """The frames are those of `clmorph.morph`; the ends are the pictures."""
    Pictures.images = squares(torch)
    Pictures.several = [squares(torch, shift=4), squares(torch, shift=2)]
    images, masks = asked(graph, "Morph", FILM)
    assert len(images) == 2  # of a list each element is morphed
    for found, mask, target in zip(images, masks, Pictures.several, strict=True):
        assert tuple(found.shape) == (3, 10, 12, 3)
        assert tuple(mask.shape) == (3, 10, 12)
        assert str(found.dtype).endswith("float32")
        frames = found.numpy()
        assert np.array_equal(frames[0], Pictures.images.numpy()[0])
        assert np.array_equal(frames[2], target.numpy()[0])
        assert not mask.numpy().any()
        film = clmorph.morph(
            Pictures.images.numpy()[0], target.numpy()[0], n_frames=3, blur=0.2, size=None,
            preset="photo", landmarks=None, backend="numpy",
        )  # fmt: skip
        assert np.array_equal(frames[1], np.clip(film[1], 0, 1))
    shown = comfyui.Bar.shown
    assert shown[-1] == 1.0
    asked(graph, "Morph", FILM)
    assert graph.runs == ["p", "n"]


def test_one_frame_and_batches(graph, torch):
    Pictures.images = squares(torch, 3)
    Pictures.several = [squares(torch, shift=4)]
    ((found,), _) = asked(graph, "Morph", FILM | {"frames": 1, "time": 1.0})
    assert tuple(found.shape) == (3, 10, 12, 3)
    assert all(np.array_equal(each, Pictures.several[0].numpy()[0]) for each in found.numpy())


def test_sizes_and_opacity(graph, torch, rng):
    """Frames have the size of the first picture; a fourth channel and masks are opacity."""
    Pictures.images = batch(torch, rng, 1, 8, 12, 4)
    Pictures.several = [batch(torch, rng, 1, 12, 6, 3)]
    (found,), (mask,) = asked(graph, "Morph", FILM)
    assert tuple(found.shape) == (3, 8, 12, 4)
    assert np.allclose(found.numpy()[0], Pictures.images.numpy()[0], atol=1 / 254)
    assert np.allclose(mask.numpy(), 1 - found.numpy()[..., 3])

    Pictures.images = squares(torch)
    hidden = np.zeros((1, 10, 12), np.float32)
    hidden[:, :, 8:] = 1
    Pictures.masks = torch.from_numpy(hidden)
    Pictures.several = [squares(torch, shift=4)]
    given = FILM | {"source_mask": ("p", 1), "target_mask": ("p", 1)}
    (found,), (mask,) = asked(graph, "Morph", given, 1)
    assert tuple(found.shape) == (3, 10, 12, 3)
    assert np.allclose(mask.numpy()[0], hidden[0], atol=1e-6)
    # What Load Image gives for a picture without opacity.
    Pictures.masks = torch.from_numpy(np.zeros((1, 64, 64), np.float32))
    _, (mask,) = asked(graph, "Morph", given, 2)
    assert not mask.numpy().any()


def test_mixes(graph, torch):
    Pictures.images, Pictures.several = squares(torch), [squares(torch, shift=4)]
    given = MIX | {"weight_b": 0.0, "options": QUICK}
    ((found,), _) = asked(graph, "Mix", given | {"grid": 0})
    assert np.array_equal(found.numpy(), Pictures.images.numpy())
    ((found,), _) = asked(graph, "Mix", given)
    assert tuple(found.shape) == (3, 10, 12, 3)
    more = {"grid": 2, "image_c": ("p", 0), "image_d": ("p", 2)}
    ((found,), _) = asked(graph, "Mix", given | more)
    assert tuple(found.shape) == (4, 10, 12, 3)
    assert np.array_equal(found.numpy()[3], Pictures.several[0].numpy()[0])


@pytest.mark.parametrize(("name", "given"), [("Morph", FILM), ("Mix", MIX)])
def test_the_text_of_options_wins_over_a_nodes_own(graph, torch, name, given):
    Pictures.images, Pictures.several = squares(torch), [squares(torch, shift=4)]
    options = {"preset": "pixel-art", "options": f"{QUICK}\npreset = 'photo'\nsize = 6"}
    ((found,), _) = asked(graph, name, given | options)
    assert tuple(found.shape) == (3, 5, 6, 3)


def test_rearranging(graph, torch, rng):
    Pictures.images, Pictures.several = batch(torch, rng, 1, 8, 8, 3), [squares(torch)]
    given = {
        "source": ("p", 0), "target": ("p", 2), "frames": 1, "time": 1.0, "color_weight": 2.0,
        **COMMON,
    }  # fmt: skip
    ((found,), _) = asked(graph, "Rearrange", given)
    one, other = (np.sort(each.numpy()[0].reshape(-1, 3), axis=0)
                  for each in (Pictures.images, found))  # fmt: skip
    assert np.array_equal(one, other)


def test_recoloring(graph, torch, rng):
    """One map for a batch: equal pixels of two pictures stay equal; a mask keeps the others."""
    images = rng.random((2, 9, 9, 3)).astype(np.float32)
    images[1, :4] = images[0, :4]
    Pictures.images = torch.from_numpy(images)
    Pictures.several = [torch.from_numpy(images[:1] * np.float32([0.2, 0.4, 1.0]))]
    hidden = np.zeros((1, 9, 9), np.float32)
    hidden[:, :, :5] = 1
    Pictures.masks = torch.from_numpy(hidden)
    given = {
        "images": ("p", 0), "like": ("p", 2), "strength": 1.0, "color_space": "oklab",
        "blur": 0.1, "feather": 0.0, "device": "numpy",
    }  # fmt: skip
    ((found,),) = asked(graph, "Recolor", given)
    assert np.array_equal(found.numpy()[0, :4], found.numpy()[1, :4])
    assert found.numpy()[..., 0].mean() < 0.5 * images[..., 0].mean()
    ((found,),) = asked(graph, "Recolor", given | {"mask": ("p", 1)})
    assert np.array_equal(found.numpy()[:, :, 5:], images[:, :, 5:])
    assert not np.array_equal(found.numpy()[:, :, :5], images[:, :, :5])


def test_tables(graph, torch, rng, tmp_path, monkeypatch):
    """A table is read again when its file has changed, and applied as `apply_lut` does."""
    comfyui.install(monkeypatch, inputs=tmp_path)
    levels = np.linspace(0.0, 1.0, 5)
    table = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1)
    clmorph.write_lut(tmp_path / "look.cube", clmorph.Lut(1.0 - table))
    Pictures.images = batch(torch, rng, 2, 6, 7, 4)
    hidden = np.zeros((1, 6, 7), np.float32)
    hidden[:, :, :3] = 1
    Pictures.masks = torch.from_numpy(hidden)
    given = {"images": ("p", 0), "lut": ("l", 0), "strength": 1.0, "device": "numpy"}
    plan = {
        "p": ("Pictures", {"seed": 0}),
        "l": ("ClmorphLoadLut", {"path": "look.cube"}),
        "a": ("ClmorphApplyLut", given),
    }
    ((found,),) = graph.run(plan, "a")
    images = Pictures.images.numpy()
    assert np.allclose(found.numpy()[..., :3], 1.0 - images[..., :3], atol=1e-6)
    assert np.array_equal(found.numpy()[..., 3], images[..., 3])
    graph.run(plan, "a")
    assert graph.runs.count("l") == 1
    clmorph.write_lut(tmp_path / "look.cube", clmorph.Lut(0.0 * table))
    plan["a"] = ("ClmorphApplyLut", given | {"mask": ("p", 1)})
    ((found,),) = graph.run(plan, "a")
    assert graph.runs.count("l") == 2
    assert not found.numpy()[:, :, :3, :3].any()
    assert np.array_equal(found.numpy()[:, :, 3:], images[:, :, 3:])
    plan["l"] = ("ClmorphLoadLut", {"path": "missing.cube"})
    (fault,) = graph.faults(plan)
    assert "missing.cube: no such file" in fault
    (tmp_path / "bad.cube").write_text("LUT_3D_SIZE 2\nnan 0 0\n")
    plan["l"] = ("ClmorphLoadLut", {"path": "bad.cube"})
    with pytest.raises(clmorph.FileError, match=r"bad\.cube"):
        graph.run(plan, "a")


def test_the_user_stops(graph, torch, monkeypatch):
    """In a solve, and between two frames; the next run is whole."""
    Pictures.images, Pictures.several = squares(torch), [squares(torch, shift=4)]
    for reports in (1, 4):
        comfyui.install(monkeypatch, stop_after=reports)
        with pytest.raises(comfyui.Interrupted):
            asked(graph, "Morph", FILM)
        assert len(comfyui.Bar.shown) == reports
    comfyui.install(monkeypatch)
    assert tuple(asked(graph, "Morph", FILM)[0][0].shape) == (3, 10, 12, 3)


def test_without_comfyui(torch):
    """The classes work in any Python, without a bar."""
    assert "comfy" not in sys.modules
    images, _ = NODE_CLASS_MAPPINGS["ClmorphMorph"]().run(
        squares(torch), squares(torch, shift=4), **MORPH
    )
    assert tuple(images.shape) == (3, 10, 12, 3)


def test_mistakes_before_the_run(graph):
    given = {"source": ("p", 0), "target": ("p", 1), **MORPH, "frames": 0}
    for options, words in (
        ("reach = far", "options: "),
        ("reech = 0.2", "unknown option"),
        ("blur = -1", "blur"),
    ):
        plan = {"p": ("Pictures", {"seed": 0}), "m": ("ClmorphMorph", given | {"options": options})}
        wrong = graph.faults(plan)
        assert wrong[:2] == ["m: target has the wrong type", "m: frames is out of range"]
        assert words in wrong[2].lower()
        assert "\n" not in wrong[2]


def test_mistakes_in_the_run(torch):
    morph = NODE_CLASS_MAPPINGS["ClmorphMorph"]().run
    good = squares(torch)
    void = torch.from_numpy(np.full((1, 4, 4, 3), np.nan, np.float32))
    wide = torch.from_numpy(np.zeros((1, 4, 4, 7), np.float32))
    none = torch.from_numpy(np.zeros((0, 4, 4, 3), np.float32))
    mask = torch.from_numpy(np.zeros((3, 4, 4), np.float32))
    mix = MIX | {"image_a": good, "image_b": good, "grid": 1}
    for call, words in (
        (lambda: morph(void, good, **MORPH), "source holds NaN"),
        (lambda: morph(good, wide, **MORPH), "target has shape"),
        (lambda: morph(none, good, **MORPH), "not empty"),
        (lambda: morph(np.zeros((1, 4, 4, 3)), good, **MORPH), "source is a ndarray"),
        (lambda: morph(squares(torch, 2), squares(torch, 3), **MORPH), "source holds 2 pictures"),
        (lambda: morph(good, good, source_mask=mask, **MORPH), "source_mask has shape"),
        (lambda: morph(good, good, **MORPH | {"device": "nowhere"}), "nowhere"),
        (lambda: NODE_CLASS_MAPPINGS["ClmorphMix"]().run(**mix), "grid=1"),
    ):
        with pytest.raises(clmorph.ClmorphError, match=words) as raised:
            call()
        assert "\n" not in str(raised.value)
    assert issubclass(InputError, ValueError)
