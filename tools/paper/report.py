"""Write the page as one file that contains its pictures and is readable on a phone."""

import base64
import csv
import math
from collections.abc import Sequence
from html import escape
from pathlib import Path

from paper.setting import Section

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 58rem; padding: 1rem; background: #fff; color: #1c1c1c;
  font: 1rem/1.5 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 1rem 0 .5rem; }
h2 { font-size: 1.2rem; line-height: 1.3; margin: 0 0 .6rem; }
section { border-top: 1px solid #ddd; margin-top: 1.8rem; padding-top: 1.2rem; }
img { display: block; width: 100%; height: auto; margin: .6rem 0; }
.pair { display: flex; gap: 1rem; }
.pair figure { flex: 1; margin: 0; max-width: 14rem; }
.pair img { image-rendering: pixelated; margin: 0 0 .3rem; }
figcaption, .small { font-size: .85rem; color: #555; }
.says { background: #f1f6fa; border-left: 4px solid #0072b2; padding: .5rem .8rem;
  margin: .6rem 0; overflow-wrap: anywhere; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .8rem; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .36rem; text-align: right; border-bottom: 1px solid #e2e2e2; }
th { font-weight: 600; vertical-align: bottom; }
th.group { text-align: center; border-bottom: 2px solid #bbb; }
td:first-child, th:first-child { text-align: left; }
td { white-space: nowrap; }
td:first-child { position: sticky; left: 0; background: #fff; }
nav ul { columns: 20rem 2; padding-left: 1.2rem; margin: .5rem 0; }
a { color: #005a8e; }
code { overflow-wrap: anywhere; }
"""


def html_table(
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    groups: Sequence[tuple[str, int]] | None = None,
) -> str:
    """Return a table that scrolls sideways where it does not fit."""
    head = ""
    if groups:
        cells = "".join(
            f'<th class="group" colspan="{span}">{escape(title)}</th>' if title else "<th></th>"
            for title, span in groups
        )
        head = f"<tr>{cells}</tr>"
    head += "<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in header) + "</tr>"
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f'<div class="scroll"><table><thead>{head}</thead><tbody>{body}</tbody></table></div>'


def write_csv(section: Section, folder: Path) -> None:
    """Write a section's numbers."""
    with (folder / f"{section.name}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(section.header)
        for row in section.rows:
            writer.writerow(_number(cell) if isinstance(cell, float) else cell for cell in row)


def _number(cell: float) -> str:
    """Write a number; what does not apply stays empty."""
    return "" if math.isnan(cell) else f"{cell:.8g}"


def write_report(
    folder: Path, sections: Sequence[Section], pair: Sequence[tuple[Path, str]], facts: str
) -> None:
    """Write ``report.html`` beside the pictures that it embeds.

    Parameters
    ----------
    folder : Path
    sections : sequence of Section
    pair : two of (picture, caption)
    facts : str
        HTML: what was run, on what.
    """
    pictures = "".join(
        f'<figure><img alt="{escape(caption)}" src="{_data_uri(path)}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for path, caption in pair
    )
    contents = "".join(
        f'<li><a href="#{section.name}">{escape(section.title)}</a></li>' for section in sections
    )
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>The paper, reproduced</title><style>{STYLE}</style></head><body>"
        "<h1>The paper’s tables and figures, for these two images</h1>"
        f'<div class="pair">{pictures}</div>{facts}<nav><ul>{contents}</ul></nav>'
        + "".join(_section(section, folder) for section in sections)
        + "</body></html>\n"
    )
    (folder / "report.html").write_text(page, encoding="utf-8")


def _section(section: Section, folder: Path) -> str:
    path = folder / f"{section.name}.png"
    return (
        f'<section id="{section.name}"><h2>{escape(section.title)}</h2>'
        f"<p>{escape(section.shows)}</p>{section.table}"
        f'<img alt="{escape(section.title)}" src="{_data_uri(path)}">'
        f'<p class="says">{escape(section.says)}</p>'
        f'<p class="small">{escape(section.parameters)} Numbers: '
        f"<code>{section.name}.csv</code></p></section>"
    )


def _data_uri(path: Path) -> str:
    return f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
