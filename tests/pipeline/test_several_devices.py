"""Whole solves, plans and morphs on several devices: those of one device."""

import json
import subprocess
import time
import weakref
from pathlib import Path

import numpy as np
import pytest
from conftest import TESTED
from programs import COMMAND
from several import KINDS, pictures

import clmorph
from clmorph.backends.multi_device import members_of
from clmorph.frames.frame_renderer import FrameRenderer
from clmorph.frames.registration import Scene

#: The coverage below which a pixel is compared more loosely.
THIN = 0.01


@pytest.mark.parametrize("kind", KINDS)
def test_devices_share_a_batch(device, rng, kind):
    """Problems of several lists, large ones and such of a measure with itself among them."""
    sources = [(np.full(n, 1 / n), rng.random((n, 2))) for n in (5, 9, 30, 70, 200)]
    targets = [sources[0], *((np.full(n, 1 / n), rng.random((n, 2))) for n in (8, 40, 6, 100))]
    several, shares = KINDS[kind](device), []
    one = clmorph.sinkhorn_batch(sources, targets, 0.1, 0.3, backend=device)
    two = clmorph.sinkhorn_batch(
        sources, targets, 0.1, 0.3, backend=several, progress=shares.append
    )
    assert len(two) == 5
    for ours, theirs in zip(one, two, strict=True):
        assert ours.dual == pytest.approx(theirs.dual, abs=ours.gap + theirs.gap)
        assert ours.f.shape == theirs.f.shape
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    again = clmorph.sinkhorn_batch(sources, targets, 0.1, 0.3, backend=several)
    assert all(a.f.tobytes() == b.f.tobytes() for a, b in zip(two, again, strict=True))
    values = [
        clmorph.divergence_matrix(sources, 0.1, 0.3, backend=backend).values
        for backend in (device, several)
    ]
    assert values[1] == pytest.approx(values[0], abs=1e-6)
    with pytest.raises(clmorph.InputError, match="problem 1"):
        clmorph.sinkhorn_batch(sources[:2], [targets[0], ([1.0], [[0.0]])], 0.1, backend=several)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "options",
    [{}, {"preset": "paper"}, {"sample": 4, "seed": 3}, {"barycentric": True}],
    ids=["default", "paper", "sample", "barycentric"],
)
def test_a_morph_is_that_of_one_device(device, kind, options):
    images, several = pictures(), KINDS[kind](device)
    one = clmorph.morph(*images, n_frames=7, backend=device, **options)
    two = clmorph.morph(*images, n_frames=7, backend=several, **options)
    frames = list(two.iter_frames())
    assert len(frames) == 7
    tolerance = 1e-3
    for t, ours, theirs in zip(one.times, one.iter_frames(), frames, strict=True):
        # Where hardly any kernel reaches, pairs at the edge of a cut kernel decide the color, and
        # NumPy and a device differ by up to a level of 8 bits.
        seen = one.coverage(float(t)) >= THIN
        assert np.abs(ours - theirs)[seen].max() <= tolerance
        assert np.abs(ours - theirs).max() <= max(tolerance, 2 / 255)
    again = clmorph.morph(*images, n_frames=7, backend=KINDS[kind](device), **options)
    assert [frame.tobytes() for frame in again.iter_frames()] == [f.tobytes() for f in frames]
    # However a frame is asked for, the same device renders it.
    assert [two[index].tobytes() for index in range(7)] == [f.tobytes() for f in frames]
    assert two.frame(float(two.times[3])).tobytes() == frames[3].tobytes()
    assert [f.tobytes() for f in two.iter_frames(5)] == [f.tobytes() for f in frames[5:]]
    assert two.parameters["device"] == several.description


def test_frames_with_opacity_are_spread_too(device):
    y, x = np.mgrid[:24, :24]
    discs = [
        np.dstack((np.full((24, 24, 3), value), ((x - c) ** 2 + (y - 12) ** 2 < 40).astype(float)))
        for value, c in ((0.9, 7), (0.3, 16))
    ]
    backends = device, KINDS["halves"](device)
    one, two = (clmorph.morph(*discs, n_frames=6, backend=backend) for backend in backends)
    assert two[0].shape[2] == 4
    np.testing.assert_allclose(one.frames, two.frames, rtol=0, atol=1e-3)
    assert list(two.iter_frames(4)) == two.frames[4:]


def test_each_device_renders_its_share(device, monkeypatch):
    several = KINDS["halves"](device)
    for member, speed in zip(several.members, (3.0, 1.0), strict=True):
        monkeypatch.setattr(member, "pairs_per_second", speed)
    rendered, corrected = [], []
    render, lacking = FrameRenderer.frame, FrameRenderer._lacking

    def counted(self, end):
        corrected.append(several.members.index(self.operations))
        return lacking(self, end)

    def frame(self, t):
        rendered.append((several.members.index(self.operations), t))
        return render(self, t)

    monkeypatch.setattr(FrameRenderer, "frame", frame)
    monkeypatch.setattr(FrameRenderer, "_lacking", counted)
    made = clmorph.morph(*pictures(), n_frames=9, backend=several, detail="particles")
    list(made.iter_frames())
    turns = {t: member for member, t in rendered}
    assert [turns[t] for t in made.times] == [0, 0, 1, 0, 0, 0, 1, 0, 0]
    # The correction of both ends is computed by one device.
    assert corrected == [0, 0]
    rendered.clear()
    made.frame(0.123)
    assert rendered == [(0, 0.123)]


def test_details_are_registered_once(device, monkeypatch):
    several = KINDS["halves"](device)
    made, register = [], Scene.meet_details
    monkeypatch.setattr(Scene, "meet_details", lambda scene: made.append(1) or register(scene))
    list(clmorph.morph(*pictures(), n_frames=9, backend=several).iter_frames())
    assert made == [1]


def test_few_frames_are_in_memory(device, monkeypatch):
    """Two of each device, and the one that the caller holds, however slow the caller is."""
    alive, most = [0], []
    render = FrameRenderer.frame

    def gone():
        alive[0] -= 1

    def watched(self, t):
        frame = render(self, t).copy()
        alive[0] += 1
        weakref.finalize(frame, gone)
        most.append(alive[0])
        return frame

    monkeypatch.setattr(FrameRenderer, "frame", watched)
    made = clmorph.morph(*pictures((9, 9)), n_frames=30, backend=KINDS["halves"](device))
    for number, _frame in enumerate(made.iter_frames()):
        time.sleep(0.05 if number < 5 else 0.0)
    assert len(most) == 30
    assert max(most) <= 2 * 2 + 1


@pytest.mark.parametrize("failing", [0, 1])
def test_a_device_that_fails_ends_the_frames(device, monkeypatch, failing):
    several = KINDS["halves"](device)
    made = clmorph.morph(*pictures((12, 12)), n_frames=12, backend=several)

    def fail(*arguments):
        raise clmorph.DeviceError("it has gone")

    frames = made.iter_frames()
    next(frames)
    monkeypatch.setattr(several.members[failing], "draw_layers", fail)
    with pytest.raises(clmorph.DeviceError, match="it has gone"):
        list(frames)
    assert all(member.lock.acquire(blocking=False) for member in several.members)
    for member in several.members:
        member.lock.release()


@pytest.mark.needs_device
def test_devices_of_two_platforms(rng):
    if len({device.platform for device in TESTED}) < 2:
        pytest.skip("needs two platforms")
    first = TESTED[0]
    other = next(device for device in TESTED if device.platform != first.platform)
    one = clmorph.morph(*pictures(), n_frames=5, backend=first.index)
    two = clmorph.morph(*pictures(), n_frames=5, backend=[first.index, other.index])
    members = [member.device for member in members_of(two.operations)]
    assert members == [first.handle, other.handle]
    for ours, theirs in zip(one.frames, two.frames, strict=True):
        assert np.abs(ours - theirs).max() <= 1e-3


@pytest.mark.full
def test_the_command_line_takes_several_devices(device, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, picture in zip(("a.png", "b.png"), pictures(), strict=True):
        clmorph.write_image(name, picture)

    def run(*arguments):
        return subprocess.run(
            [COMMAND, *arguments], capture_output=True, text=True, check=False, timeout=300
        )

    index = next(found.index for found in TESTED if found.handle == device.device)
    monkeypatch.delenv("CLMORPH_DEVICE", raising=False)
    films = "morph", "a.png", "b.png", "--frames", "4"
    made = run(*films, "-o", "out.npz", "--recipe", "--device", f"{index},numpy")
    assert made.returncode == 0, made.stderr
    described = json.loads(Path("out.npz.json").read_text())["device"]
    assert device.description in described
    assert "NumPy float64" in described
    assert ("cannot be faster" in made.stderr) == device.on_processor
    monkeypatch.setenv("CLMORPH_DEVICE", f"{index},numpy")
    again = run(*films, "-o", "other.npz")
    assert again.returncode == 0, again.stderr
    assert described in again.stderr
    first, second = (np.load(name, allow_pickle=False) for name in ("out.npz", "other.npz"))
    for key in set(first.files) - {"parameters"}:
        np.testing.assert_array_equal(first[key], second[key])
    for wrong in (f"{index},{index}", "numpy,"):
        refused = run("morph", "a.png", "b.png", "-o", "no.gif", "--device", wrong)
        assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1), refused.stderr
        assert not Path("no.gif").exists()
