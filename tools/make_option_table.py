"""Write the tables of options in `clmorph/cli/README.md` from the option classes.

``--check`` only says whether the tables are what the classes say.

    python tools/make_option_table.py
"""

import sys
from pathlib import Path

from clmorph._shared.options import Options, specifications, to_outside
from clmorph.cli.options import NAMES
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.recolor_options import RecolorOptions

PAGE = Path(__file__).parents[1] / "clmorph" / "cli" / "README.md"
#: The beginning of each table, by the class of its options, and the end of any.
STARTS: dict[type[Options], str] = {
    MorphOptions: "<!-- written by tools/make_option_table.py -->\n",
    RecolorOptions: "<!-- written by tools/make_option_table.py for recolor -->\n",
}
END = "<!-- end -->\n"
#: Panels of the help, in its order.
PANELS = ("Motion", "Transport", "Color", "Drawing", "File")


def cell(text: str) -> str:
    return text.replace("|", "\\|")


def table(options: type[Options] = MorphOptions) -> str:
    """Return the table of all options of a class, panel by panel."""
    lines = ["| option | meaning | default |\n", "|---|---|---|\n"]
    known, names = specifications(options), NAMES
    for name, option in sorted(known.items(), key=lambda item: PANELS.index(item[1].panel)):
        value = to_outside(option, getattr(options, name))
        usual = "no" if value is False else f"{value:g}" if isinstance(value, float) else str(value)
        unit = f" {option.unit}" if option.unit and not isinstance(value, str) else ""
        lines.append(f"| `{names[name]}` | {cell(option.help)} | {usual}{unit} |\n")
    return "".join(lines)


def main() -> int:
    """Write the tables, or check them."""
    page = PAGE.read_text("utf-8")
    new = page
    for options, start in STARTS.items():
        head, _, rest = new.partition(start)
        new = head + start + table(options) + END + rest.partition(END)[2]
    if "--check" in sys.argv[1:]:
        stale = f"stale: run tools/{Path(__file__).name}"
        print("the tables are " + ("up to date" if new == page else stale))
        return 0 if new == page else 1
    PAGE.write_text(new, "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
