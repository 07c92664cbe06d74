"""Write the table of options in `clmorph/cli/README.md` from the option classes.

``--check`` only says whether the table is what the classes say.

    python tools/make_option_table.py
"""

import sys
from pathlib import Path

from clmorph._shared.options import specifications, to_outside
from clmorph.cli.options import names_outside
from clmorph.pipeline.options import MorphOptions

PAGE = Path(__file__).parents[1] / "clmorph" / "cli" / "README.md"
START, END = "<!-- written by tools/make_option_table.py -->\n", "<!-- end -->\n"
#: Panels of the help, in its order.
PANELS = ("Motion", "Transport", "Drawing", "File")


def cell(text: str) -> str:
    return text.replace("|", "\\|")


def table() -> str:
    """Return the table of all options of a morph, panel by panel."""
    lines = ["| option | meaning | default |\n", "|---|---|---|\n"]
    known, names = specifications(MorphOptions), names_outside()
    assert {option.panel for option in known.values()} == set(PANELS)
    for name, option in sorted(known.items(), key=lambda item: PANELS.index(item[1].panel)):
        value = to_outside(option, getattr(MorphOptions, name))
        usual = "no" if value is False else f"{value:g}" if isinstance(value, float) else str(value)
        unit = f" {option.unit}" if option.unit and not isinstance(value, str) else ""
        lines.append(f"| `{names[name]}` | {cell(option.help)} | {usual}{unit} |\n")
    return "".join(lines)


def main() -> int:
    """Write the table, or check it."""
    head, _, rest = PAGE.read_text("utf-8").partition(START)
    written, _, tail = rest.partition(END)
    if "--check" in sys.argv[1:]:
        same = written == table()
        print(
            "the table is " + ("up to date" if same else f"stale: run tools/{Path(__file__).name}")
        )
        return 0 if same else 1
    PAGE.write_text(head + START + table() + END + tail, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
