"""Compare kernel width rules on many pairs: ``python tools/evaluate_splatting.py``.

For each rule, over all pairs and five times: Sinkhorn divergence of frames to the target (the
paper's Table 2, every pixel the same mass) and to the particles mu_t of which they are a picture
(pixels weighted by kernel mass, and alike), holes, sharpness. Prints a Markdown table of means,
and who wins how often for certain; ``--csv FILE`` keeps every number with its interval. Frames
are taken as the rules make them, without the correction of the ends.
"""

import argparse
import csv
import warnings
from importlib import resources
from pathlib import Path

import numpy as np
from plain_options import PLAIN
from rich.progress import track
from skimage import data

import clmorph
from clmorph.analysis.metrics import hole_fraction, path_divergence, sharpness
from clmorph.images.pixels import as_rgb

TIMES = (0.0, 0.25, 0.5, 0.75, 1.0)
#: Name in the table -> options of `clmorph.morph`; the paper's widths where nothing else is said.
RULES = {
    "none": {"splatting": "none"},
    "fixed, σ 0.5": {"splatting": "fixed", "sigma_start": 0.5},
    "adaptive, σ 1.2 to 0.5, γ 0.5": {},
    "adaptive, σ 0.5, γ 0.5": {"sigma_start": 0.5, "sigma_end": 0.5},
    "local, σ auto": {"splatting": "local", "sigma_start": "auto", "sigma_end": "auto"},
    "optimal": {"sigma": "optimal"},
    "optimal, local": {"sigma": "optimal", "splatting": "local"},
}
#: The bundled sprite and scikit-image's pictures that are installed with it.
PAIRS = [
    ("cat", "chelsea"),
    ("cat", "astronaut"),
    ("chelsea", "cat"),
    ("astronaut", "chelsea"),
    ("coffee", "rocket"),
    ("chelsea", "coffee"),
    ("color", "retina"),
    ("hubble_deep_field", "immunohistochemistry"),
    ("rocket", "astronaut"),
]
MEASURES = {
    "to the target": {"to": "target", "weights": "uniform"},
    "to μₜ, by kernel mass": {"to": "particles", "weights": "kernel"},
    "to μₜ, pixels alike": {"to": "particles", "weights": "uniform"},
}
#: Points to which particles are merged, for all rules alike.
POINTS = 4096


def picture(name: str, size: int) -> np.ndarray:
    """Return a picture's middle square, reduced; the sprite as it is."""
    if name == "cat":
        with resources.as_file(resources.files("clmorph.cli.samples") / "cat.png") as file:
            return clmorph.fit(clmorph.read_image(file), size)
    pixels = as_rgb(getattr(data, "colorwheel" if name == "color" else name)())
    side = min(pixels.shape[:2])
    top, left = ((length - side) // 2 for length in pixels.shape[:2])
    return clmorph.fit(pixels[top : top + side, left : left + side], size)


def evaluate(pair: tuple[str, str], size: int, backend) -> list[dict]:
    """Return a row for every rule and time."""
    images = [picture(name, size) for name in pair]
    rows = []
    for rule, options in RULES.items():
        result = clmorph.morph(
            *images, n_frames=3, backend=backend, **{**PLAIN, "endpoints": "paper", **options}
        )
        found = {
            name: path_divergence(result, TIMES, max_points=POINTS, **how)
            for name, how in MEASURES.items()
        }
        ends = [sharpness(image) for image in images]
        for number, t in enumerate(TIMES):
            row = {
                "pair": " to ".join(pair), "rule": rule, "t": t,
                "holes": hole_fraction(result.coverage(t)),
                "sharpness": sharpness(result.frame(t)) / ((1 - t) * ends[0] + t * ends[1]),
                "sigma": result.kernel_width.at(t, result.canvas(t)),
            }  # fmt: skip
            for name, values in found.items():
                row[name] = values[number]
            rows.append(row)
    return rows


def print_table(rows: list[dict]) -> None:
    columns = list(MEASURES)
    print(f"| rule | S {' | S '.join(columns)} | holes | sharpness |")
    print("|---" * (len(columns) + 3) + "|")
    for rule in RULES:
        own = [row for row in rows if row["rule"] == rule]
        means = [np.mean([row[name].value for row in own]) for name in columns]
        doubts = [
            max(row[name].interval[1] - row[name].interval[0] for row in own) for name in columns
        ]
        cells = [f"{mean:.5f} ± {doubt:.0e}" for mean, doubt in zip(means, doubts, strict=True)]
        holes, sharp = (np.mean([row[name] for row in own]) for name in ("holes", "sharpness"))
        print(f"| {rule} | {' | '.join(cells)} | {100 * holes:.3f} % | {sharp:.2f} |")
    print()
    inner = [row for row in rows if 0 < row["t"] < 1]
    cases = sorted({(row["pair"], row["t"]) for row in inner})
    for name in columns:
        certain = dict.fromkeys(RULES, 0)
        for case in cases:
            here = {row["rule"]: row[name] for row in inner if (row["pair"], row["t"]) == case}
            best = min(here, key=lambda rule: here[rule].value)
            others = [other for rule, other in here.items() if rule != best]
            certain[best] += all(here[best].closer_than(other) for other in others)
        told = ", ".join(f"{rule}: {count}" for rule, count in certain.items() if count)
        print(f"Least S {name}, for certain, of {len(cases)} frames between the ends: {told}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", type=int, default=48, help="longer side of the images")
    parser.add_argument("--pairs", type=int, default=len(PAIRS), help="only so many pairs")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--csv", type=Path)
    options = parser.parse_args()
    backend = clmorph.get_backend(options.device)
    warnings.simplefilter("ignore", clmorph.ConvergenceWarning)
    rows = []
    for pair in track(PAIRS[: options.pairs], description="pairs"):
        rows += evaluate(pair, options.size, backend)
    print(f"{options.pairs} pairs, {options.size} pixels, {backend.description}\n")
    print_table(rows)
    if options.csv:
        with options.csv.open("w", newline="") as file:
            writer = csv.writer(file)
            numbers = ["holes", "sharpness", "sigma"]
            heads = [f"S {name}{part}" for name in MEASURES for part in ("", " low", " high")]
            writer.writerow(["pair", "rule", "t", *numbers, *heads])
            for row in rows:
                values = [x for name in MEASURES for x in (row[name].value, *row[name].interval)]
                writer.writerow(
                    [row["pair"], row["rule"], row["t"]] + [row[n] for n in numbers] + values
                )


if __name__ == "__main__":
    main()
