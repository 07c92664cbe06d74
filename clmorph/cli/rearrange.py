"""The command ``clmorph rearrange``: the pixels of one picture move to form the next one."""

from collections.abc import Iterator, Sequence

from clmorph.cli.request import Request
from clmorph.images.detail import is_pixel_art
from clmorph.images.resizing import as_unit
from clmorph.output.save import recorded_for, write_all
from clmorph.pipeline.rearrange import Rearrangement, arranged


def run_rearrange(request: Request) -> None:
    """Move the pixels of the first picture into each next one; write files and a summary."""
    places, options = request.places, request.options
    request.check_files()
    motion = request.motion()
    pictures = request.read()
    request.note_thin(pictures[:1], options)
    operations = request.open()
    done: list[dict[str, float]] = []

    def chain() -> Iterator[Rearrangement]:
        pixels = pictures[0]
        for number, picture in enumerate(pictures[1:], 1):
            report = stages.marked(f" {number}" if len(pictures) > 2 else "")
            found = arranged((pixels, picture), options, operations, report)
            done.append({"cost": found.cost, "lower_bound": found.lower_bound})
            pixels = found[-1].astype(float)
            yield found

    with request.stages() as stages, recorded_for(
        places, chain(), motion, n_morphs=len(pictures) - 1, reverse=options.reverse,
        pixelated=is_pixel_art(as_unit(pictures[0])),
        parameters=request.metadata(options, operations), progress=stages,
    ) as film:  # fmt: skip
        write_all(places, film, options, stages.writing, request.texts(options, operations))
        summary = {
            "outputs": request.written,
            "frames": len(film),
            "duration": round(film.duration, 6),
            "assignments": done,
            **film.parameters,
        }
    request.finish(
        summary, stages, f"{len(film)} frames", f"; the arrangement costs {_proof(done)}"
    )


def _proof(assignments: Sequence[dict[str, float]]) -> str:
    """Return what is proven of the worst one, in words."""
    worst = max(
        (each["cost"] / each["lower_bound"] - 1 if each["lower_bound"] > 0 else float("inf"))
        if each["cost"] > 0 else 0.0
        for each in assignments
    )  # fmt: skip
    return f"at most {worst:.2%} above the cheapest" if worst < float("inf") else "no bound"
