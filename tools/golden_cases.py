"""What `golden_record.py` records: runs of the command line, calls, and what their files show."""

import base64
import dataclasses
import hashlib
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageSequence

SIZE = ("--size", "28", "--frames", "5")
#: Option sets of ``clmorph morph``: name, pictures, ending of the output, options.
COMMANDS: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("photo", "ab", ".gif", SIZE),
    ("paper", "ab", ".npz", ("--preset", "paper", "--size", "24", "--frames", "5")),
    ("pixel-art", "cb", ".webp", ("--preset", "pixel-art", *SIZE)),
    ("crossfade", "ab", ".apng", ("--preset", "crossfade", *SIZE)),
    ("balanced", "ab", ".html", ("--preset", "balanced", *SIZE)),
    ("sheet", "ab", ".png", SIZE),
    ("folder", "ab", "", (*SIZE, "--canvas", "dynamic")),
    ("tiff", "ab", ".tif", SIZE),
    ("tiff-folder", "ab", "", (*SIZE, "--format", "tiff-folder")),
    ("mp4", "ab", ".mp4", (*SIZE, "--duration", "2")),
    ("webm", "ac", ".webm", (*SIZE, "--fps", "25", "--hold", "0.2")),
    ("chain", "abc", ".webp", (*SIZE, "--loop", "ping-pong", "--ease", "smooth", "--lossless")),
    ("reverse", "cb", ".gif", (*SIZE, "--reverse", "--background", "#204060")),
    ("canvas", "ab", ".apng", (*SIZE, "--canvas", "120x64", "--scaling", "nearest")),
    ("solve-size", "ab", ".npz", ("--size", "48", "--frames", "4", "--solve-size", "12")),
    ("max-particles", "ab", ".npz", (*SIZE, "--max-particles", "4000")),
    ("sample", "ab", ".npz", (*SIZE, "--sample", "4", "--seed", "3")),
    ("barycentric", "ab", ".npz", (*SIZE, "--barycentric")),
    ("log-threshold", "ab", ".npz", (*SIZE, "--log-threshold", "-14")),
    ("strengths", "ab", ".npz", (*SIZE, "--epsilon", "0.004", "--rho", "0.05")),
    ("two reaches", "ab", ".npz", (*SIZE, "--reach", "0.2,balanced", "--blur", "0.06")),
    ("colors", "ab", ".npz", (*SIZE, "--color-space", "lab", "--path-space", "luv")),
    ("luminance", "ab", ".npz", (*SIZE, "--mass", "luminance", "--unmatched", "drop")),
    ("alpha", "cd", ".npz", (*SIZE, "--mass", "alpha", "--extent", "unit")),
    ("adaptive", "ab", ".npz", (*SIZE, "--gamma", "1.0", "--sigma-start", "1.5")),
    ("fixed", "ab", ".npz", (*SIZE, "--splatting", "fixed", "--sigma-start", "0.9")),
    ("no kernel", "ab", ".npz", (*SIZE, "--splatting", "none", "--endpoints", "paper")),
    ("optimal", "ab", ".npz", ("--size", "16", "--frames", "3", "--sigma", "optimal")),
)  # fmt: skip


def digest(value: Any) -> Any:
    """Return a value with every array in the place of which its digest stands."""
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value)
        return f"{data.dtype}{list(data.shape)} {hashlib.sha256(data.tobytes()).hexdigest()[:24]}"
    if isinstance(value, bytes):
        return hashlib.sha256(value).hexdigest()[:24]
    if isinstance(value, float | np.floating):
        return float(value).hex()
    if isinstance(value, dict):
        return {str(name): digest(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [digest(part) for part in value]
    return value if isinstance(value, int | str | bool | None) else str(value)


def fields(value: Any, *names: str) -> dict[str, Any]:
    """Return attributes of a result, or the arrays and numbers among its fields."""
    chosen = names or [each.name for each in dataclasses.fields(value)]
    return digest({name: getattr(value, name) for name in chosen})


def shown(path: Path) -> Any:
    """Return what a file shows."""
    ending = path.suffix
    if path.is_dir():
        return {file.name: shown(file) for file in sorted(path.iterdir())}
    if ending == ".npz":
        with np.load(path) as arrays:
            return digest({name: arrays[name] for name in arrays.files if name != "parameters"})
    if ending == ".html":
        text = path.read_text("utf-8")
        parts = re.findall(r'class="frame">([A-Za-z0-9+/=]+)<', text)
        assert parts
        return [digest(base64.b64decode(part)) for part in parts]
    if ending in (".mp4", ".webm"):
        command = ("ffmpeg", "-v", "error", "-i", str(path), "-map", "0:v", "-f", "md5", "-")
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
    if ending == ".tif":
        import tifffile

        with tifffile.TiffFile(path) as file:
            return [digest(page.asarray()) for page in file.pages]
    with Image.open(path) as image:
        return [
            [digest(np.asarray(frame.convert("RGBA"))), frame.info.get("duration")]
            for frame in ImageSequence.Iterator(image)
        ]


def pictures(folder: Path) -> dict[str, np.ndarray]:
    """Return four pictures, written there as files too: two opaque ones, two that are not."""
    from skimage.data import astronaut, chelsea

    rng = np.random.default_rng(16)
    sprite = np.zeros((20, 24, 4), np.uint8)
    sprite[3:17, 4:20, :3] = rng.integers(0, 4, (14, 16, 3)) * 85
    sprite[3:17, 4:20, 3] = 255
    sprite[12:, 15:, 3] //= 2
    found = {
        "a": chelsea()[:, 85:385],
        "b": astronaut()[:200, 120:360],
        "c": sprite,
        "d": sprite[::-1, ::-1].copy(),
    }
    for name, pixels in found.items():
        Image.fromarray(pixels).save(folder / f"{name}.png")
    return found


def commands(backend: str, folder: Path) -> Iterator[tuple[str, Any]]:
    """Run the command line once for each of `COMMANDS`."""
    from clmorph.__main__ import main

    place = ("--backend", "numpy") if backend == "numpy" else ("--device", backend)
    for name, names, ending, options in COMMANDS:
        if name == "optimal" and backend == "numpy":
            continue  # hundreds of divergences
        output = folder / f"out-{name.replace(' ', '-')}{ending}"
        inputs = [str(folder / f"{picture}.png") for picture in names]
        sys.argv = ["clmorph", "morph", *inputs, "-o", str(output), *place, *options]
        try:
            code = main()
        except SystemExit as error:
            code = error.code
        assert not code, f"{name}: exit code {code}"
        yield f"command: {name}", shown(output)


def calls(backend: str, folder: Path) -> Iterator[tuple[str, Any]]:
    """Call the library; every option whose default could differ is given."""
    import clmorph
    from clmorph.analysis.channel_baseline import channel_morph
    from clmorph.analysis.metrics import hole_fraction, path_divergence, sharpness

    found = pictures(folder)
    a, b, c = (clmorph.fit(found[name] / 255.0, 20) for name in "abc")
    source, target = (clmorph.lift(image, color_weight=0.7) for image in (a, b))
    rng = np.random.default_rng(5)
    clouds = [
        (weights / weights.sum(), rng.normal(0, 0.3, (number, 3)))
        for number, weights in ((300, rng.random(300)), (260, rng.random(260)))
    ]
    for name, options in {
        "unbalanced": {"blur": 0.05, "reach": 0.3},
        "balanced": {"blur": 0.1, "reach": None},
        "one side": {"blur": 0.08, "reach": (0.3, None)},
        "float64": {"blur": 0.02, "reach": 0.3, "precision": "float64", "tol": 1e-5},
        "geomloss": {"blur": 0.05, "reach": 0.3, "method": "geomloss"},
    }.items():
        both = ("f", "g", "residual", "residuals", "dual", "primal", "gap", "truncation_error",
                "row_mass", "column_mass", "n_iter", "status", "marginal_error")  # fmt: skip
        images = clmorph.sinkhorn(source, target, backend=backend, **options)
        points = clmorph.sinkhorn(*clouds, backend=backend, **options)
        plan = clmorph.transport_plan(source, target, images, backend=backend)
        yield f"sinkhorn: {name}", [fields(images, *both), fields(points, *both), fields(plan)]
    potentials = clmorph.sinkhorn(source, target, blur=0.05, reach=0.3, backend=backend)
    plan = clmorph.transport_plan(source, target, potentials, backend=backend, log_threshold=-13)
    yield "plan: threshold", fields(plan)
    draws = clmorph.sample_plan(source, target, potentials, draws=5, seed=2, backend=backend)
    means = clmorph.barycentric_plan(source, target, potentials, backend=backend)
    moved = clmorph.displacement_statistics(source, target, plan)
    yield "plan: draws, means, displacement", [fields(draws), fields(means), fields(moved)]
    near = clmorph.sinkhorn_divergence(source, target, blur=0.05, reach=0.3, backend=backend)
    yield "divergence", fields(near, "value", "interval")
    common: dict[str, Any] = {
        "n_frames": 4, "blur": 0.05, "reach": 0.3, "color_weight": 0.7, "sigma_start": 1.2,
        "sigma_end": 0.5, "splatting": "adaptive", "path_space": "srgb",
        "endpoints": "exact", "unmatched": "fade", "extent": "true", "backend": backend,
        "solve_size": None, "max_particles": None,
    }  # fmt: skip
    if "preset" in inspect.signature(clmorph.morph).parameters:
        common["size"] = None  # later than 0.1.0
    weights = np.random.default_rng(3).random(a.shape[:2])
    metric = np.diag([2.0, 1.0, 0.5])
    for name, pair, options in (
        ("as it is", (a, b), {}),
        ("opacity", (c, b), {"splatting": "local", "sigma_start": "auto"}),
        ("weights", (a, b), {"weights": (weights, None), "color_metric": metric}),
    ):
        result = clmorph.morph(*pair, **{**common, **options})
        frames = [result.frame(float(t)) for t in result.times]
        record = digest([frames, result.coverage(0.4), result.sigma])
        if name == "as it is":
            record.append(digest(path_divergence(result, [0, 0.5], to="target")[0].value))
            record.append(digest([hole_fraction(result.coverage(0.5)), sharpness(frames[1])]))
        yield f"morph: {name}", record
    channels = channel_morph(a, b, n_frames=4, blur=0.05, reach=0.3, extent="true", backend=backend)
    yield "channels", digest(channels.frames)
    if backend == "numpy":
        plain = {"extent": "true", "unmatched": "fade", "log_threshold": None}
        tiny = clmorph.fit(a, 10), clmorph.fit(b, 10)
        yield (
            "reference",
            digest([np.asarray(f) for f in clmorph.reference.morph(*tiny, **plain).frames]),
        )
        return
    # Large enough to be solved through coarser problems.
    large = [clmorph.lift(clmorph.fit(found[name] / 255.0, 120), 0.5) for name in "ab"]
    found_there = clmorph.sinkhorn(*large, blur=0.05, reach=0.3, backend=backend)
    yield "multiscale", fields(found_there, "f", "g", "residual", "dual", "primal", "n_iter")
