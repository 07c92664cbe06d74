"""Measure how good films are, beside cross-fades: ``python tools/bench_films.py``.

Makes films of nine frames with the defaults, of photographs, drawings, words and sprites, and
prints their measures (`clmorph.analysis.metrics.film_measures`) as a Markdown table, at t = 1/4,
1/2 and 3/4 (*low band*: their mean; *share*: of a cross-fade, at 1/2). Beside each film stand a
cross-fade, a wipe in place (regions change hands in a random smooth order, nothing moves), and the
particles alone, by `preset="photo"` and `detail="particles"`. (By the preset `logo` particles are
those of the foreground, and fill a flat background with its colors.) The means follow.

The last table is of pictures paired with their own smooth deformation by 6 %: how much nearer the
frame at 1/2 is to the true middle than a cross-fade, in dB, and the absolute ghosts of the frame,
of the true middle and of the cross-fade at 1/2. That of the true middle is not 0, because the
measure misleads for pictures that are alike. So the mean ghost leaves out such pairs.

``--only NAME`` takes the pairs with NAME in their names, ``--pictures FOLDER`` keeps a contact
sheet of each pair, the film over the cross-fade, and ``--flicker`` makes films of 49 frames.
Photographs of scikit-learn are left out if it is missing.
"""

import argparse
from pathlib import Path

import numpy as np
from benching import line, print_head
from picture_pairs import DEFORMATIONS, FILM_PAIRS, Picture, deformed, picture, psnr
from PIL import Image
from rich.console import Console
from rich.progress import track
from scipy.ndimage import gaussian_filter

import clmorph
from clmorph.analysis.metrics import FilmMeasures, film_measures, ghost
from clmorph.images.pixels import resized

#: Frames of a film, and of one whose flicker is measured.
FRAMES, FLICKER_FRAMES = 9, 49
#: The ghost of a cross-fade below which only the film's own counts.
LITTLE_GHOST = 0.03
#: Share of the wipe's time in which one region changes hands.
SOFTNESS = 0.1
#: Ghosts of 0.2.0, at other sizes and cuts of the same photographs.
BEFORE = {"astronaut, cat": 0.44, "coffee, rocket": 0.30, "astronaut, camera": 0.40}
#: Pictures that are alike in place.
ALIKE = ("deformed", "left eye")
FILMS = ("film", "cross-fade", "wipe", "particles")
#: Films are measured without landmarks: what is drawn is judged, and not what is found.
PLAIN = {"landmarks": None}
#: Options of the particles alone.
PARTICLES = {"preset": "photo", "detail": "particles"}


# --- the films ------------------------------------------------------------------------------


def over(image: Picture, level: float) -> Picture:
    """Return a picture as opaque colors, on gray of a level."""
    if image.shape[-1] == 3:
        return image
    return level + (image[..., :3] - level) * image[..., 3:]


def crossfade(first: Picture, last: Picture, count: int) -> list[Picture]:
    return [(1 - t) * first + t * last for t in np.linspace(0, 1, count)]


def wipe(first: Picture, last: Picture, count: int) -> list[Picture]:
    """Return a film in which regions change hands in a random smooth order."""
    noise = np.random.default_rng(0).normal(size=first.shape[:2])
    smooth = gaussian_filter(noise, max(first.shape) / 12)
    order = np.argsort(np.argsort(smooth, axis=None)).reshape(smooth.shape) / smooth.size
    film = []
    for t in np.linspace(0, 1, count):
        share = np.clip((t * (1 + SOFTNESS) - order) / SOFTNESS, 0, 1)[..., None]
        film.append((1 - share) * first + share * last)
    return film


def films(ends: tuple[Picture, Picture], count: int, device: str) -> dict[str, list[Picture]]:
    """Return the films of a pair by their names in `FILMS`."""
    film = list(clmorph.morph(*ends, n_frames=count, backend=device, **PLAIN))
    particles = clmorph.morph(*ends, n_frames=FRAMES, backend=device, **PLAIN, **PARTICLES)
    shape = film[count // 2].shape[:2]
    # As they are measured: of one size, opacity over gray.
    plain = [resized(over(film[number], 0.5), shape) for number in (0, -1)]
    made = (film, crossfade(*plain, count), wipe(*plain, count), list(particles))
    return dict(zip(FILMS, made, strict=True))


def sheet(rows: list[list[Picture]], height: int = 160) -> Image.Image:
    """Return nine frames of each film side by side, on white."""
    strips = []
    for film in rows:
        chosen = [film[round(at)] for at in np.linspace(0, len(film) - 1, FRAMES)]
        levels = [np.rint(255 * np.clip(over(each, 1.0), 0, 1)).astype(np.uint8) for each in chosen]
        images = [Image.fromarray(each) for each in levels]
        how = Image.Resampling.NEAREST if images[0].height < 64 else Image.Resampling.BICUBIC
        strips.append([e.resize((e.width * height // e.height, height), how) for e in images])
    width = max(sum(image.width + 4 for image in strip) for strip in strips)
    whole = Image.new("RGB", (width, len(strips) * (height + 4)), "white")
    for row, strip in enumerate(strips):
        x = 0
        for image in strip:
            whole.paste(image, (x, row * (height + 4)))
            x += image.width + 4
    return whole


# --- tables and aims ------------------------------------------------------------------------


def low_band(found: FilmMeasures) -> float:
    """Return the mean low-band distance over the times."""
    assert found.low_band_distance is not None
    return float(np.mean(found.low_band_distance))


def spaced(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.2f}" for value in values)


def row(pair: str, name: str, found: FilmMeasures) -> str:
    """Return the table row of a film."""
    relative = f"{found.ghost:.2f}" if found.ghost_of_crossfade >= LITTLE_GHOST else ""
    if name == "film" and pair in BEFORE:
        relative += f" (0.2.0: {BEFORE[pair]:.2f})"
    cells = [
        pair, name, relative, f"{found.ghost_absolute:.3f}", f"{found.crossfade_share:.2f}",
        f"{low_band(found):.1f}", spaced(found.relative_sharpness), spaced(found.relative_crumbs),
        f"{found.unevenness:.2f}", "" if found.flicker is None else f"{found.flicker:.2f}",
    ]  # fmt: skip
    return line(*cells)


def is_judged_by_ghost(pair: str) -> bool:
    return not any(words in pair for words in ALIKE)


def mean_ghost(measured: dict[str, FilmMeasures]) -> float:
    """Return the mean over pairs of unlike pictures whose cross-fade has a ghost; NaN for none."""
    ghosts = [
        found.ghost
        for pair, found in measured.items()
        if is_judged_by_ghost(pair) and found.ghost_of_crossfade >= LITTLE_GHOST
    ]
    return float(np.mean(ghosts)) if ghosts else np.nan


def mean_row(name: str, measured: dict[str, FilmMeasures]) -> str:
    """Return the table row of the means of films over all pairs."""
    every = list(measured.values())
    flickers = [found.flicker for found in every if found.flicker is not None]
    cells = [
        "mean", name, f"{mean_ghost(measured):.2f}".replace("nan", ""),
        f"{np.mean([found.ghost_absolute for found in every]):.3f}",
        f"{np.mean([found.crossfade_share for found in every]):.2f}",
        f"{np.mean([low_band(found) for found in every]):.1f}",
        spaced(tuple(np.mean([found.relative_sharpness for found in every], axis=0))),
        spaced(tuple(np.mean([found.relative_crumbs for found in every], axis=0))),
        f"{np.mean([found.unevenness for found in every]):.2f}",
        f"{np.mean(flickers):.2f}" if flickers else "",
    ]  # fmt: skip
    return line(*cells)


def judge_deformed(name: str, seed: int, device: str) -> str:
    """Return the table row of a picture and its own deformation."""
    first = picture(name)
    truth, last = deformed(first, seed)
    middles = [
        clmorph.morph(first, last, n_frames=3, backend=device, **PLAIN, **way).frame(0.5)[..., :3]
        for way in ({}, PARTICLES)
    ]
    fade = (first + last) / 2
    quality = psnr(fade, truth)
    gains = [psnr(middle, truth) - quality for middle in middles]
    ghosts = [ghost(frame, first, last) for frame in (middles[0], truth, fade)]
    cells = [f"{gain:+.1f}" for gain in gains] + [f"{each:.3f}" for each in ghosts]
    return line(f"{name} deformed {seed}", f"{quality:.1f}", *cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="", metavar="NAME")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER")
    parser.add_argument("--flicker", action="store_true")
    options = parser.parse_args()
    pairs = [pair for pair in FILM_PAIRS if options.only in pair]
    deformations = [
        (name, seed) for name, seed in DEFORMATIONS if options.only in f"{name} deformed {seed}"
    ]
    if not pairs and not deformations:
        parser.error(f"no pair has {options.only!r} in its name: {'; '.join(FILM_PAIRS)}")
    if options.pictures:
        options.pictures.mkdir(parents=True, exist_ok=True)
    count = FLICKER_FRAMES if options.flicker else FRAMES
    terminal = Console(stderr=True)
    measured: dict[str, dict[str, FilmMeasures]] = {name: {} for name in FILMS}
    print_head(
        "pair", "film", "ghost", "absolute", "share", "low band", "sharp", "crumbs", "uneven",
        "flicker",
    )  # fmt: skip
    for pair in track(pairs, "pairs", console=terminal, transient=True):
        try:
            ends = FILM_PAIRS[pair]()
        except ImportError as error:
            print(line(pair, f"left out: {error}", *8 * [""]), flush=True)
            continue
        made = films(ends, count, options.device)
        for name, film in made.items():
            measured[name][pair] = film_measures(film, made["particles"])
            print(row(pair, name, measured[name][pair]), flush=True)
        if options.pictures:
            file = options.pictures / f"{pair.replace(', ', '-').replace(' ', '-')}.png"
            sheet([made["film"], made["cross-fade"]]).save(file)
    for name in FILMS if measured["film"] else ():
        print(mean_row(name, measured[name]))
    if deformations:
        print()
        print_head(
            "pair", "cross-fade, dB", "film", "particles", "ghost", "true middle's", "cross-fade's"
        )
    for name, seed in track(deformations, "deformed", console=terminal, transient=True):
        print(judge_deformed(name, seed, options.device), flush=True)


if __name__ == "__main__":
    main()
