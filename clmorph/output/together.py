"""Files that are written together: all of them whole, or none."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from clmorph._shared.files import atomic_paths, check_apart, errors_as_output


def write_together(
    writers: Sequence[tuple[Path, Path, Callable[[Path], None]]],
    texts: Mapping[Path, str] | None = None,
) -> None:
    """Write files (place, path as given, writer), and `texts` by path, all whole or none."""
    beside = dict(texts or {})
    places = [*(place for place, _, _ in writers), *beside]
    check_apart(places)
    with atomic_paths(places) as made:
        for new, (place, text) in zip(made[len(writers) :], beside.items(), strict=True):
            with errors_as_output(place):
                new.write_text(text, "utf-8")
        for new, (_, path, write) in zip(made, writers, strict=False):
            with errors_as_output(path):
                write(new)
