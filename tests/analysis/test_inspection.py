import dataclasses
import functools
import gc
import json
import os
import re
import subprocess
import sys
import time
import tracemalloc
import warnings
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest
from clouds import PAIRS
from marks import full
from PIL import Image
from skimage import data

import clmorph
from clmorph._shared.printable import percent, size_text, time_text
from clmorph.analysis.figures import check_plotting, draw_field, draw_inspection
from clmorph.analysis.inspect import inspect
from clmorph.analysis.inspection import Inspection
from clmorph.analysis.timing import frame_seconds
from clmorph.backends.opencl.kernels import launches
from clmorph.cli.main import main
from clmorph.errors import ConvergenceWarning, InputError, MemoryWarning, OutputError, PlanSizeError
from clmorph.frames.particles import particles
from clmorph.images.pixels import as_rgb
from clmorph.pipeline.budget import predict_pairs
from clmorph.pipeline.memory import DRAWN, PARTICLE, Memory, estimate, most_particles
from clmorph.pipeline.presets import PRESETS

OPTIONS = {"blur": 0.05, "reach": 0.3, "color_weight": 0.5}
PHOTO = {"blur": 0.03, "reach": 0.3, "color_weight": 0.5}
#: Every pair of the plan between the pixels themselves is one particle.
WHOLE = {"solve_size": None, "max_particles": None}


def _picture(shape, phase=0.0, channels=3):
    y, x = np.mgrid[: shape[0], : shape[1]] / max(shape)
    waves = [0.5 + 0.5 * np.sin(k * x + 3 * y + phase) for k in (3, 5, 7)]
    if channels == 4:
        waves.append((x + y > 0.5).astype(float))
    return np.dstack(waves)


def _photos(side):
    return tuple(
        clmorph.fit(as_rgb(picture), side) for picture in (data.astronaut(), data.chelsea())
    )


@pytest.fixture(scope="module")
def images():
    return _picture((14, 11)), _picture((10, 16), 2.0)


@pytest.fixture(scope="module")
def found(images):
    return inspect(*images, backend="numpy", **OPTIONS)


def _numbers(value):
    """All leaves of a summary."""
    if isinstance(value, dict):
        return [leaf for part in value.values() for leaf in _numbers(part)]
    if isinstance(value, list):
        return [leaf for part in value for leaf in _numbers(part)]
    return [value]


def _is_json(found):
    text = json.dumps(found.summary(), allow_nan=False)
    assert json.loads(text) == found.summary()
    for leaf in _numbers(found.summary()):
        assert leaf is None or isinstance(leaf, str | bool | int) or np.isfinite(leaf)
    lines = found.lines()
    assert all(line == line.strip() and "\n" not in line and "nan" not in line for line in lines)
    return found.summary()


class TestNumbers:
    def test_are_those_of_the_functions_that_compute_them(self, images, found):
        source, target = (clmorph.lift(image, 0.5) for image in images)
        potentials = clmorph.sinkhorn(source, target, 0.05, 0.3, backend="numpy")
        plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
        moved = clmorph.displacement_statistics(source, target, plan)
        np.testing.assert_array_equal(found.potentials.f, potentials.f)
        np.testing.assert_array_equal(found.plan.indices, plan.indices)
        np.testing.assert_array_equal(found.plan.mass, plan.mass)
        np.testing.assert_array_equal(found.displacement.field, moved.field)
        assert found.pairs == len(plan)
        assert found.pair_bytes == pytest.approx(plan.nbytes, abs=8)
        summary = _is_json(found)
        assert summary["displacement_pixels"] == {
            "max": moved.max, "mean": moved.mean, "mass_weighted_mean": moved.mass_weighted_mean
        }  # fmt: skip
        assert summary["mass"]["transported"] == pytest.approx(plan.total_mass)
        assert summary["mass"]["destroyed"] == pytest.approx(moved.destroyed.sum())
        assert summary["mass"]["created"] == pytest.approx(moved.created.sum())
        assert 0.02 < summary["mass"]["destroyed"] < 0.9
        assert summary["solver"]["residual"] == potentials.residual < 1e-3
        assert summary["plan"]["dropped_mass"] == plan.dropped_mass
        moving = particles(source, target, plan)
        assert found.particles == len(moving)
        held = moving.links.nbytes + moving.weights.nbytes + moving.table.nbytes
        assert found.particle_bytes == held

    def test_shares_are_of_each_image_s_own_mass(self, images, found):
        maps = tuple(np.full(image.shape[:2], 7.0 / image[..., 0].size) for image in images)
        heavy = inspect(*images, backend="numpy", weights=maps, divergence=False, **OPTIONS)
        assert heavy.source.mass == pytest.approx(7)
        assert 7 * heavy.destroyed == pytest.approx(heavy.displacement.destroyed.sum(), rel=1e-12)
        assert heavy.transported < 1.5

    def test_divergence_is_the_divergence_and_solves_nothing_twice(self, images, found):
        source, target = (clmorph.lift(image, 0.5) for image in images)
        alone = clmorph.sinkhorn_divergence(source, target, 0.05, 0.3, backend="numpy")
        assert found.divergence.value == alone.value
        assert found.divergence.interval == alone.interval
        assert found.divergence.cross is found.potentials
        low, high = found.divergence.interval
        assert low <= found.divergence.value <= high
        assert _is_json(found)["divergence"] == {"value": alone.value, "low": low, "high": high}

    def test_potentials_of_another_problem_are_no_cross_term(self, images, found):
        source, target = (clmorph.lift(image, 0.5) for image in images)
        for pair, reach in (((source, source), 0.3), ((source, target), 0.2)):
            with pytest.raises(InputError, match=r"cross: .*expected"):
                clmorph.sinkhorn_divergence(
                    *pair, 0.05, reach, backend="numpy", cross=found.potentials
                )

    def test_devices_agree_with_numpy(self, images, found, device):
        there = inspect(*images, backend=device, **OPTIONS)
        here, other = _is_json(found), _is_json(there)
        for group in ("mass", "displacement_pixels"):
            assert other[group] == pytest.approx(here[group], rel=2e-3)
        assert other["plan"]["pairs"] == pytest.approx(here["plan"]["pairs"], rel=1e-3)
        assert there.device == device.description
        low, high = there.divergence.interval
        assert max(low, found.divergence.interval[0]) <= min(high, found.divergence.interval[1])

    def test_options_reach_the_transport(self, images):
        short = inspect(
            *images, backend="numpy", divergence=False, epsilon=0.0025, rho=0.0025, extent="unit",
            color_space="oklab", mass="luminance", tol=1e-2, n_frames=7, color_weight=1.5,
        )  # fmt: skip
        summary = _is_json(short)
        assert summary["options"] == {
            "blur": 0.05, "reach": [0.05, 0.05], "color_weight": 1.5, "color_space": "oklab",
            "extent": "unit",
        }  # fmt: skip
        assert summary["seconds"]["n_frames"] == 7
        assert np.ptp(short.source.weights) > 0
        assert 1e-4 < short.potentials.residual < 1e-2

    def test_progress_tells_each_stage_to_its_end(self, images):
        told = {}
        inspect(*images, backend="numpy", progress=told.__setitem__, **OPTIONS)
        assert told == {"transport": 1.0, "divergence": 1.0, "plan": 1.0, "timing": 1.0}


class TestNasty:
    def test_two_single_pixels(self, device):
        found = inspect(np.full((1, 1, 3), 0.2), np.full((1, 1, 3), 0.9), backend=device)
        assert found.pairs == 1
        assert found.displacement.max == 0
        _is_json(found)

    def test_a_pixel_and_a_row(self, tmp_path):
        found = inspect(_picture((1, 1)), _picture((1, 9)), backend="numpy", **OPTIONS)
        _is_json(found)
        draw_inspection(found, tmp_path / "row.png")

    def test_equal_images_are_at_no_distance(self, images):
        same = inspect(images[0], images[0], backend="numpy", **OPTIONS)
        assert same.divergence.value == 0
        assert same.divergence.interval[0] == 0
        _is_json(same)

    @pytest.mark.full
    def test_opacity_leaves_pixels_without_mass(self, images, device, tmp_path):
        found = inspect(_picture((14, 11), channels=4), images[1], backend=device, **OPTIONS)
        summary = _is_json(found)
        assert summary["source"]["points_with_mass"] < summary["source"]["points"]
        assert "with mass" in found.lines()[0]
        draw_inspection(found, tmp_path / "clear.png")

    def test_balanced_has_a_gap_and_a_divergence(self, images):
        found = inspect(*images, backend="numpy", blur=0.05, reach=None, color_weight=0.5)
        summary = _is_json(found)
        solver = summary["solver"]
        assert solver["gap"] == solver["primal"] - solver["dual"] > 0
        assert summary["solver"]["marginal_error"] > 0
        assert summary["options"]["reach"] == [None, None]
        assert summary["divergence"]["low"] <= summary["divergence"]["high"]
        assert summary["mass"]["transported"] == pytest.approx(1, abs=2e-3)
        assert "marginals off" in "\n".join(found.lines())

    @pytest.mark.parametrize(
        ("options", "reason"),
        [
            ({"reach": (0.3, None)}, "reach differs"),
            ({"reach": 0.3, "color_metric": np.full((14, 11), 0.5)}, "its own metric"),
            ({"reach": 0.3, "divergence": False}, "not asked for"),
        ],
    )
    def test_where_there_is_no_divergence_the_reason_stands(self, images, options, reason):
        found = inspect(*images, backend="numpy", blur=0.05, color_weight=0.5, **options)
        summary = _is_json(found)
        assert found.divergence is None
        assert summary["divergence"] is None
        assert reason in summary["no_divergence"]
        assert reason in "\n".join(found.lines())

    def test_a_plan_that_is_too_large_is_counted_and_measured_all_the_same(self, images, device):
        whole = inspect(*images, backend=device, divergence=False, **OPTIONS)
        found = inspect(*images, backend=device, divergence=False, max_bytes=1000, **OPTIONS)
        assert found.plan is None
        assert found.pairs == whole.pairs
        summary = _is_json(found)
        assert summary["plan"]["built"] is False
        assert summary["plan"]["dropped_mass"] is None
        assert summary["seconds"]["plan_estimated"] is True
        assert summary["memory_bytes"] == whole.summary()["memory_bytes"]
        np.testing.assert_allclose(
            found.displacement.field, whole.displacement.field, atol=0.02 * whole.displacement.max
        )
        assert found.displacement.mass_weighted_mean == pytest.approx(
            whole.displacement.mass_weighted_mean, rel=1e-3
        )
        assert found.destroyed == pytest.approx(whole.destroyed, abs=1e-3)

    @pytest.mark.full
    def test_a_streamed_displacement_needs_no_color(self, images):
        options = {"blur": 0.05, "color_weight": 0.0, "backend": "numpy", "divergence": False}
        whole = inspect(*images, **options)
        found = inspect(*images, max_bytes=1000, **options)
        assert found.displacement.max == pytest.approx(whole.displacement.max, rel=1e-2)

    def test_the_solver_s_failure_is_told(self, images):
        with pytest.warns(ConvergenceWarning):
            found = inspect(*images, backend="numpy", max_iter=2, divergence=False, **OPTIONS)
        assert _is_json(found)["solver"]["status"] == "max_iter"

    @pytest.mark.parametrize(
        "options", [{"blur": -1}, {"n_frames": 1}, {"max_bytes": 0}, {"weights": 3}, {"mass": "x"}]
    )
    def test_mistakes_are_told_before_any_work(self, images, options):
        with pytest.raises(InputError):
            inspect(*images, backend="none such", **options)

    def test_the_size_of_a_plan_is_told_to_programs(self, images, found):
        with pytest.raises(PlanSizeError) as caught:
            clmorph.transport_plan(
                found.source, found.target, found.potentials, max_bytes=1000, backend="numpy"
            )
        assert caught.value.pairs == found.pairs
        assert isinstance(caught.value, InputError)


class TestPairs:
    @pytest.mark.parametrize("name", PAIRS)
    def test_counted_where_the_sample_is_all(self, name, rng):
        (x, a), (y, b) = PAIRS[name](rng)
        source, target = (a, x), (b, y)
        potentials = clmorph.sinkhorn(source, target, 0.1, 0.5, backend="numpy")
        plan = clmorph.transport_plan(source, target, potentials, backend="numpy")
        predicted = predict_pairs(source, target, potentials, rows=600, backend="numpy")
        # The counts may differ by pairs whose mass rounds to either side of the threshold.
        assert predicted == pytest.approx(len(plan), rel=1e-3, abs=1)
        tau = float(np.log(np.median(plan.mass))) - 1e-6
        few = clmorph.transport_plan(source, target, potentials, log_threshold=tau, backend="numpy")
        options = {"log_threshold": tau, "rows": 600, "backend": "numpy"}
        predicted = predict_pairs(source, target, potentials, **options)
        assert 0 < len(few) <= len(plan)
        assert predicted == pytest.approx(len(few), abs=1)

    @pytest.mark.parametrize("tau", [None, -13.0])
    @pytest.mark.parametrize("options", [PHOTO, {"blur": 0.05, "reach": 0.3, "color_weight": 2.0}])
    def test_predicted_from_few_rows(self, device, options, tau):
        source, target = (clmorph.lift(image, options["color_weight"]) for image in _photos(48))
        potentials = clmorph.sinkhorn(
            source, target, options["blur"], options["reach"], backend=device
        )
        problem = source, target, potentials
        kept = len(clmorph.transport_plan(*problem, log_threshold=tau, backend=device))
        few = {"log_threshold": tau, "rows": 256, "backend": device}
        predicted = [predict_pairs(*problem, seed=seed, **few) for seed in range(8)]
        assert np.mean(predicted) == pytest.approx(kept, rel=0.06)
        np.testing.assert_allclose(predicted, kept, rtol=0.2)


class _Counted:
    """The most bytes of buffers on a device: with those that its pool holds, and without."""

    def __init__(self, monkeypatch, device):
        self.live = self.peak = self.used = 0
        counted, self.pool = self, device.work._pool
        original, empty = launches.cl.Buffer, launches.Workspace.empty
        self.pool.free_held()
        self.before, self.active = self.pool.managed_bytes, self.pool.active_bytes

        class Buffer(original):
            def __init__(self, *arguments, **options):
                super().__init__(*arguments, **options)
                counted.change(self.size)

            def __del__(self):
                counted.live -= self.size

        def counted_empty(work, n_bytes):
            buffer = empty(work, n_bytes)
            counted.change(0)
            return buffer

        monkeypatch.setattr(launches.cl, "Buffer", Buffer)
        monkeypatch.setattr(launches.Workspace, "empty", counted_empty)

    def change(self, size):
        self.live += size
        self.peak = max(self.peak, self.live + self.pool.managed_bytes - self.before)
        self.used = max(self.used, self.live + self.pool.active_bytes - self.active)


class TestMemory:
    @pytest.mark.parametrize(
        ("blur", "way", "channels", "detail"),
        [
            (0.03, {}, 3, "layers"),
            *(pytest.param(*each, "particles", marks=pytest.mark.full) for each in (
                (0.03, {}, 3), (0.015, {}, 3), (0.03, {"sample": 16}, 3),
                (0.03, {"barycentric": True}, 3), (0.015, {}, 4),
            )),
            pytest.param(0.015, {}, 4, "layers", marks=pytest.mark.full),
        ],
    )  # fmt: skip
    def test_on_devices_within_a_factor_of_two(
        self, device, monkeypatch, blur, way, channels, detail
    ):
        first, second = _photos(64)
        if channels == 4:
            first = np.dstack((first, _picture(first.shape[:2], channels=4)[..., 3]))
        morph = functools.partial(
            clmorph.morph, first, second, n_frames=5, blur=blur, reach=0.3, color_weight=0.5,
            path_space="srgb", detail=detail, backend=device, **WHOLE, **way,
        )  # fmt: skip
        # What is imported, built or verified at first use is no part of a morph, nor is garbage.
        morph().frame(0.5)
        gc.collect()
        counted = _Counted(monkeypatch, device)
        tracemalloc.start()
        try:
            result = morph()
            solved, before_frames = tracemalloc.get_traced_memory()
            for t in (0.0, 0.3, 0.5):
                result.frame(t)
            _, host = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        pixels = sum(len(measure) for measure in (result.source, result.target))
        memory = estimate(
            pixels, (pixels // 2, pixels // 2), len(result.plan), device,
            alpha=channels == 4, frame=pixels // 2,
        )  # fmt: skip
        assert 0.5 < memory.host / host < 2, (memory.host, host, before_frames, solved)
        # What the pool holds for reuse depends on the sizes of launches, and so on their duration.
        assert memory.device / counted.used > 0.5, (memory.device, counted.used)
        # Layers take less: the particles stay on the host.
        if detail == "particles":
            assert memory.device / counted.peak < 2.2, (memory.device, counted.peak)
        assert memory.shared
        assert memory.needs == (memory.host + memory.device,)

    def test_as_many_particles_as_fit(self, device):
        for shared in (True, False):
            none = Memory(10**8, 10**7, shared)
            most = most_particles(10**9, none, alpha=False)
            host, on_device = PARTICLE * most, DRAWN * most
            if shared:
                assert host + on_device == pytest.approx(10**9 - 11 * 10**7)
            else:
                assert max(none.host + host, none.device + on_device) == pytest.approx(10**9)
            assert most_particles(10**6, none, alpha=False) < 0


# Before the change the command printed 80 MB for the draft and 709 MB for the chain.
RUNS = {
    "small": ("a.png", "b.png", "--size", "48"),
    "large": ("large.png", "b.png", "--frames", "5"),
    "draft": ("a.png", "b.png", "--draft"),
    "chain": ("a.png", "b.png", "a.png", "--frames", "3"),
    "numpy": ("a.png", "b.png", "--size", "32", "--frames", "2", "--backend", "numpy"),
    "768": ("large.png", "large.png", "--size", "768", "--frames", "2"),
}


@pytest.mark.needs_device
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("kind", ["draft", *full(*(kind for kind in RUNS if kind != "draft"))])
def test_the_command_says_the_peak_of_its_process(kind, tmp_path):
    """Reading and resizing pictures included, within 30 %."""
    photos = [Image.fromarray(getattr(data, name)()) for name in ("astronaut", "coffee")]
    for name, photo in zip("ab", photos, strict=True):
        photo.resize((256, 256)).save(tmp_path / f"{name}.png")
    if "large.png" in RUNS[kind]:
        side = 768 if kind == "768" else 4000
        photos[0].resize((side, side)).save(tmp_path / "large.png", compress_level=1)
    code = (
        "import sys; from pathlib import Path; from clmorph.cli.main import main;"
        "code = main(sys.argv[1:]);"
        "print(Path('/proc/self/status').read_text());"
        "sys.exit(code)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, "morph", *RUNS[kind], "-o", "o.gif"],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    peak = 1024 * int(re.search(r"VmHWM:\s*(\d+) kB", run.stdout)[1])
    said, unit = re.search(r"memory: about ([\d.]+) ([MG])B", run.stderr).groups()
    said = float(said) * {"M": 1e6, "G": 1e9}[unit]
    assert 0.7 < said / peak < 1.3, (said, peak)


class TestTime:
    """Of the processor, all threads together: other work on the machine comes and goes."""

    @pytest.fixture(autouse=True)
    def _own_time(self, monkeypatch):
        monkeypatch.setattr("clmorph.analysis.timing.perf_counter", time.process_time)

    def _soon(self, ratios, most):
        """Of four times, as runtimes' threads also wait in earnest, one is within a factor."""
        told = []
        while not told or not all(1 / most < each < most for each in told[-1]):
            assert len(told) < 4, f"times are off by {told}"
            told.append(ratios())

    @pytest.mark.full
    @pytest.mark.parametrize(("side", "blur"), [(32, 0.03), (64, 0.015), (64, 0.03)])
    def test_of_frames_is_about_what_they_take(self, device, side, blur):
        result = clmorph.morph(
            *_photos(side), n_frames=12, blur=blur, reach=0.3, color_weight=0.5, backend=device,
            **WHOLE,
        )  # fmt: skip
        given = result.source, result.target, result.potentials, result.plan, len(result.plan)

        def ratio():
            found = frame_seconds(*given, 12, device)
            fresh, began = dataclasses.replace(result), time.process_time()
            list(fresh.iter_frames())
            return (found / (time.process_time() - began),)

        self._soon(ratio, 2)

    @pytest.mark.full
    def test_of_frames_by_a_sample_is_about_that_of_all(self, device, monkeypatch):
        found = inspect(*_photos(64), backend=device, divergence=False, **PHOTO)
        given = found.source, found.target, found.potentials

        def ratios():
            whole = frame_seconds(*given, found.plan, found.pairs, 30, device)
            with monkeypatch.context() as patch:
                patch.setattr("clmorph.analysis.timing.SAMPLED_PAIRS", found.pairs // 3)
                plans = found.plan, None
                return [frame_seconds(*given, it, found.pairs, 30, device) / whole for it in plans]

        self._soon(ratios, 2.5)

    def test_doubles_with_the_frames(self, found):
        given = found.source, found.target, found.potentials, found.plan, found.pairs
        backend = clmorph.get_backend("numpy")
        few, many = (frame_seconds(*given, count, backend, "particles") for count in (2, 200))
        assert many > 5 * few > 0


class TestPicture:
    @pytest.mark.in_turns
    @pytest.mark.parametrize(
        ("ending", "start"), [(".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")]
    )
    def test_is_of_its_ending_and_the_same_every_time(self, found, tmp_path, ending, start):
        first, second = tmp_path / f"a{ending}", tmp_path / f"b{ending.upper()}"
        for path in (first, second):
            draw_inspection(found, path)
        assert first.read_bytes().startswith(start)
        assert first.read_bytes() == second.read_bytes()
        assert sorted(path.name for path in tmp_path.iterdir()) == sorted([first.name, second.name])

    def test_holds_every_panel_and_number(self, found, tmp_path):
        """And leaves the caller's Matplotlib as it was."""
        import matplotlib

        with matplotlib.rc_context({"svg.fonttype": "none"}):
            before = dict(matplotlib.rcParams)
            draw_inspection(found, tmp_path / "a.svg")
            assert dict(matplotlib.rcParams) == before
        text = (tmp_path / "a.svg").read_text(encoding="utf-8")
        for word in (
            "Source", "Target", "Displacement of every", "Destroyed", "Created", "How far",
            "Residual", percent(found.transported), f"{found.displacement.max:.4g}",
            f"{found.divergence.value:.5g}", size_text(found.particle_bytes), "NumPy float64",
        ):  # fmt: skip
            assert word in text

    def test_shows_the_images(self, tmp_path):
        red, blue = np.zeros((2, 8, 8, 3))
        red[..., 0], blue[..., 2] = 1, 1
        found = inspect(red, blue, backend="numpy", divergence=False, **OPTIONS)
        draw_inspection(found, tmp_path / "a.png")
        with Image.open(tmp_path / "a.png") as opened:
            pixels = np.asarray(opened.convert("RGB")).astype(int)
        assert pixels.shape == (1040, 1820, 3)
        half = pixels[:, : pixels.shape[1] // 2], pixels[:, pixels.shape[1] // 2 :]
        for part, color in zip(half, ((255, 0, 0), (0, 0, 255)), strict=True):
            assert np.all(part == color, axis=2).sum() > 50_000

    @pytest.mark.full
    def test_says_nothing_of_a_cache_of_fonts(self, tmp_path):
        """On a slow machine matplotlib does, after 5 seconds: here at once."""
        script = """
import threading
plain = threading.Timer
threading.Timer = lambda interval, *more: plain(0.0, *more)
from clmorph.analysis.figures import check_plotting
check_plotting()
"""
        done = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True,
            env=os.environ | {"MPLCONFIGDIR": str(tmp_path)},
        )  # fmt: skip
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
        assert list(tmp_path.glob("fontlist*"))

    @pytest.mark.full
    def test_has_few_arrows_and_none_where_nothing_moves(self, device):
        from matplotlib.figure import Figure

        clear = np.dstack((_picture((60, 80)), np.tile(np.arange(80) >= 40, (60, 1))))
        found = inspect(clear, _picture((20, 20), 1.0), backend=device, solve_size=None, **OPTIONS)
        axes = Figure().add_subplot()
        arrows = draw_field(axes, found.source.colors.reshape(60, 80, 3), found.displacement, 1.0)
        assert 100 < arrows.N <= 24 * 24 / 2
        assert arrows.X.min() >= 40

    def test_an_interrupt_leaves_the_old_one(self, found, tmp_path, monkeypatch):
        path = tmp_path / "a.png"
        path.write_bytes(b"old")

        def interrupt(self, place, **options):
            place.write_bytes(b"half")
            raise KeyboardInterrupt

        monkeypatch.setattr("matplotlib.figure.Figure.savefig", interrupt)
        with pytest.raises(KeyboardInterrupt):
            draw_inspection(found, path)
        assert path.read_bytes() == b"old"
        assert list(tmp_path.iterdir()) == [path]

    @pytest.mark.parametrize("name", ["a.jpg", "a", "missing/a.png", ".", ""])
    def test_impossible_places_are_told_before_any_work(self, name, tmp_path):
        with pytest.raises(OutputError):
            check_plotting(tmp_path / name if name else "")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (size_text(0), "0 bytes"),
        (size_text(999), "999 bytes"),
        (size_text(999_999), "1 MB"),
        (size_text(1.5e9), "1.5 GB"),
        (size_text(4e15), "4000 TB"),
        (time_text(0.0), "0 ms"),
        (time_text(0.01234), "12.3 ms"),
        (time_text(0.9999), "1 s"),
        (time_text(61), "61 s"),
        (time_text(99.7), "1.66 min"),
        (percent(0.0), "0 %"),
        (percent(1.0), "100 %"),
        (percent(0.1234), "12.3 %"),
        (percent(1e-9), "under 0.0001 %"),
    ],
)
def test_numbers_for_people(text, expected):
    assert text == expected


def test_an_inspection_names_itself(found):
    assert isinstance(found, Inspection)
    assert repr(found).startswith("<Inspection of 11 x 14 into 16 x 10 pixels, ")


class TestWhatAMorphWouldDraw:
    """Particles are those that `clmorph.morph` makes with the same options."""

    def _check(self, found, images, **options):
        with warnings.catch_warnings(action="ignore", category=MemoryWarning):
            result = clmorph.morph(*images, n_frames=3, backend="numpy", **options)
        assert found.moving == len(result.plan)
        assert found.seconds.frames > 0
        _is_json(found)
        assert all(len(line) > 14 for line in found.lines())
        return result

    LABELS = np.eye(16, dtype=int)

    @pytest.mark.in_turns
    @pytest.mark.parametrize(
        "options",
        [
            {},
            {"solve_size": 8},
            {"max_particles": 700},
            {"max_particles": 700, "solve_size": 8},
            {"max_particles": 1, "solve_size": 8},
            {"log_threshold": -11.0},
            {"log_threshold": -10.0, "solve_size": 8},
            {"log_threshold": -10.0, "solve_size": 8, "labels": (LABELS, LABELS[:11])},
        ],
    )
    def test_with_limits(self, options):
        images = _photos(16)
        options = {"blur": 0.1, "color_weight": 0.5, **options}
        found = inspect(*images, backend="numpy", divergence=False, **options)
        self._check(found, images, **options)

    def test_limits_are_numbers_of_any_kind(self):
        with pytest.raises(InputError, match="expected at least"):
            inspect(*_photos(8), backend="numpy", max_memory=Decimal("3e4"))

    def test_means_where_cells_are_too_large_for_draws(self, monkeypatch, device):
        monkeypatch.setattr("clmorph.pipeline.budget.MAX_DRAWS", 8)
        images = _photos(16)
        options = {"blur": 0.1, "max_particles": 10, "solve_size": 4}
        for backend in ("numpy", device):
            found = inspect(*images, backend=backend, divergence=False, **options)
            result = self._check(found, images, **options)
            assert isinstance(result.plan, clmorph.Barycentric)

    @pytest.mark.parametrize("limit", [1, 5])
    def test_within_some_memory(self, device, limit):
        """The device has no more of it: what gives way is said, and measured."""
        images = _photos(32)
        options = {"blur": 0.3, "max_memory": 1.0}
        with pytest.raises(InputError, match=r"max_memory=.* at least"):
            inspect(*images, backend=device, divergence=False, **options)
        least = estimate(2048, (1024, 1024), 1024 * limit, device, frame=1024)
        options["max_memory"] = 1.01 * max(least.needs)
        with pytest.warns(MemoryWarning, match="in their place") as caught:
            found = inspect(*images, backend=device, divergence=False, **options)
        assert caught[0].filename == __file__
        with pytest.warns(MemoryWarning):
            result = clmorph.morph(*images, n_frames=3, backend=device, **options)
        assert found.moving == len(result.plan) < found.pairs
        assert max(found.memory.needs) <= options["max_memory"]

    @pytest.mark.full
    def test_cells_whose_plan_is_too_large(self):
        images = _photos(16)
        options = {"blur": 0.1, "solve_size": 8, "backend": "numpy", "divergence": False}
        whole = inspect(*images, **options)
        found = inspect(*images, max_bytes=1000, **options)
        assert found.plan is None
        assert found.moving == 4 * found.pairs == 4 * whole.pairs
        assert found.moving == pytest.approx(whole.moving, rel=0.1)
        assert found.seconds.frames > 0

    @pytest.mark.full
    @pytest.mark.parametrize("preset", list(PRESETS))
    def test_in_every_preset(self, preset, tmp_path, capfd, refused):
        """The command line's limits, in proportion to the size of the pictures."""
        pictures = [str(tmp_path / f"{name}.png") for name in ("astronaut", "coffee")]
        for path in pictures:
            Image.fromarray(getattr(data, Path(path).stem)()).save(path)
        options = ["--size", "40", "--max-particles", "3000", "--json"]
        if preset != "paper":
            options += ["--solve-size", "20"]
        assert main(["inspect", *pictures, "--preset", preset, *options]) == 0
        summary = json.loads(capfd.readouterr().out)
        # Thinned to the limit, but never below one a pixel.
        assert summary["particles"]["count"] <= 3000 + 2 * (40 * 40 + 40 * 27)
        told = refused("inspect", *pictures, "--size", "40", "--max-memory", "1e-6")
        assert "--max-memory 1e-06 GB: expected at least" in told
