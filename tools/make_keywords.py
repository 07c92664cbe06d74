"""Write `clmorph/pipeline/keywords.py`: the types of options by name.

Type checkers cannot read them from the option classes. ``--check`` only says whether the file is
what the classes say.

    python tools/make_keywords.py
"""

import sys
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args, get_origin

from clmorph._shared.options import Options
from clmorph.pipeline.documentation import annotation
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.rearrange_options import RearrangeOptions
from clmorph.pipeline.recolor_options import RecolorOptions

FILE = Path(__file__).parents[1] / "clmorph" / "pipeline" / "keywords.py"
HEAD = '''"""The types of options by name, for type checkers.

Written by ``tools/make_keywords.py`` from the option classes: change those.
"""

from collections.abc import Sequence
from typing import Literal, TypedDict
'''
CLASS = '''

class {name}Keywords(TypedDict, total=False):
    """Options of `clmorph.{function}` by name."""

'''
#: Largest length of a line.
LENGTH = 100
#: The classes of options, by the functions that take them.
CLASSES: dict[str, type[Options]] = {
    "morph": MorphOptions,
    "rearrange": RearrangeOptions,
    "recolor": RecolorOptions,
}


def name_of(kind: Any) -> str:
    """Return a type as it is written."""
    if get_origin(kind) is None:
        return "None" if kind is type(None) else annotation(kind)
    parts = get_args(kind)
    if "Literal" in str(get_origin(kind)):
        return f"Literal[{', '.join(map(quoted, parts))}]"
    if get_origin(kind) is tuple:
        return f"tuple[{', '.join(map(name_of, parts))}]"
    if get_origin(kind) is Sequence:
        return f"Sequence[{name_of(parts[0])}]"
    return " | ".join(map(name_of, parts))


def quoted(text: str) -> str:
    return f'"{text}"'


def line_of(name: str, kind: Any) -> str:
    """Return the line of an option, or several lines where one is too long."""
    line = f"    {name}: {name_of(kind)}\n"
    if len(line) <= LENGTH:
        return line
    parts = "\n        | ".join(map(name_of, get_args(kind)))
    return f"    {name}: (\n        {parts}\n    )\n"


def made() -> str:
    """Return the file's text."""
    text = HEAD
    for function, options in CLASSES.items():
        text += CLASS.format(name=function.capitalize(), function=function)
        text += "".join(
            line_of(each.name, each.type) for each in fields(options) if "option" in each.metadata
        )
    return text


def main() -> int:
    """Write the file, or check it."""
    text = made()
    if "--check" in sys.argv[1:]:
        same = FILE.read_text("utf-8") == text
        print(f"{FILE.name} is " + ("up to date" if same else "stale: run tools/make_keywords.py"))
        return 0 if same else 1
    FILE.write_text(text, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
