"""The command ``clmorph mix``: pictures between several pictures, as a grid or as a film."""

from collections.abc import Sequence
from typing import Any

from clmorph._shared.printable import printable
from clmorph.cli.request import Request
from clmorph.errors import InputError
from clmorph.pipeline.mixing.mix import mix
from clmorph.pipeline.mixing.mixes import pairs_of
from clmorph.pipeline.mixing.weights import check_mix_weights, grid_layout, grid_sides, path_weights
from clmorph.pipeline.mixing.writing import check_outputs, write_film, write_sheet


def run_mix(request: Request) -> None:
    """Mix pictures, write the output files, and print a summary."""
    count, shown = len(request.images), request.shown or {}
    if len(shown) > 1:
        first, second = list(shown)[:2]
        raise InputError(f"--{first} and --{second} contradict: give one of them")
    route = shown.get("path", shown.get("stops"))
    stops = None if route is None else path_weights(route, count)
    weights = check_mix_weights(shown["weights"], count) if "weights" in shown else stops
    grid = grid_sides("--grid", shown["grid"]) if "grid" in shown else None
    if weights is None:
        grid_layout(count, grid)  # raises an error before pictures are read
    places = request.places
    request.check_files()
    n_stops = 0 if stops is None else len(stops)
    check_outputs(places, n_stops, request.options)
    pictures, _, guide, preset, operations = request.prepared(pairs_of(count))
    chosen = guide.options
    with request.stages() as stages:
        mixes = mix(pictures, weights, chosen, grid=grid, backend=operations, progress=stages)
        parameters = request.metadata(chosen, operations)
        texts = request.texts(chosen, operations)
        summary: dict[str, Any] = {
            "outputs": request.written,
            "mixes": len(mixes),
            "preset": preset,
            "found": guide.found,
        }
        if stops is None:
            write_sheet(places, mixes.sheet(chosen.background), parameters, texts)
            what = f"{len(mixes)} mixes"
        else:
            legs = mixes.path(list(stops))
            frames, seconds = write_film(
                places, legs, chosen, mixes.pixelated, parameters, texts, stages
            )
            summary |= {"frames": frames, "duration": round(seconds, 6)}
            what = f"{frames} frames{request.round_text(seconds)}"
        summary |= parameters
    request.finish(summary, stages, what)


def weights_of(texts: Sequence[str], count: int) -> list[list[float]]:
    """Return the weights of each mix from texts such as 1,2,1 of `count` numbers each."""
    found = []
    for text in texts:
        try:
            found.append([float(part) for part in text.split(",")])
        except ValueError:
            found.append([])
        if len(found[-1]) != count:
            raise InputError(
                f"--weights {printable(text, 40)}: expected {count} numbers with commas, one for "
                "each picture, such as " + ",".join("1" * count)
            )
    return found
