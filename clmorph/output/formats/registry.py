"""The list of all formats: a new one is a module and an entry here."""

from pathlib import Path
from types import ModuleType

from clmorph.output.formats import apng, archive, gif, page, sheet, stills, video, webp
from clmorph.output.formats.format import Format

#: Modules of formats, in the order in which help and messages list them. Each has `FORMATS`.
MODULES: tuple[ModuleType, ...] = (gif, webp, apng, video, page, sheet, archive, stills)
#: Every format by its name.
FORMATS: dict[str, Format] = {
    format.name: format for module in MODULES for format in module.FORMATS
}


def usual_endings() -> list[str]:
    """Return the usual ending of each format that has one."""
    return [ending for format in FORMATS.values() for ending in format.endings[:1] if ending]


def by_ending(path: Path) -> Format | None:
    """Return the format that a path's ending stands for; None if no format has it."""
    ending = path.suffix.lower()
    return next((format for format in FORMATS.values() if ending in format.endings), None)
