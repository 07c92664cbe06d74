"""The page about all results of a folder: thumbnails, links and figures that can be sorted."""

import math
import os
import re
from collections.abc import Iterable, Mapping
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from clmorph._shared.files import atomic_path
from clmorph._shared.printable import size_text
from clmorph.batch.places import INDEX, is_remote, local_output, name_of, resolved
from clmorph.output.html.page import ascii_html, digest

#: The columns with numbers: the key of a record, the heading, and the format.
NUMBERS = (
    ("seconds", "seconds", "{:.1f}"),
    ("iterations", "iterations", "{:d}"),
    ("residual", "residual / ε", "{:.1e}"),
    ("particles", "particles", "{:d}"),
    ("frames", "frames", "{:d}"),
    ("bytes", "size", ""),
)


def write_index(folder: str, records: Iterable[Mapping[str, Any]]) -> str:
    """Write a page of the journal's records into the folder of outputs, and return its path."""
    place = resolved(INDEX, folder)
    text = index_page(folder, list(records))
    with local_output(place) as path:
        if is_remote(place):
            path.write_text(text, "ascii")
        else:
            with atomic_path(path) as new:
                new.write_text(text, "ascii")
    return place


def index_page(folder: str, records: list[Mapping[str, Any]]) -> str:
    """Return the page as one text in ASCII, which loads nothing but its own thumbnails."""
    style, script = _resource("index.css"), _resource("index.js")
    done = [record for record in records if record["status"] == "done"]
    heads = [("text", "output"), ("", "start, middle, end"), ("text", "status")]
    heads += [("number", title) for _, title, _ in NUMBERS] + [("text", "device"), ("text", "note")]
    n_failed = len(records) - len(done)
    slots = {
        "policy": (
            f"default-src 'none'; img-src data:; style-src '{digest(style)}'; "
            f"script-src '{digest(script)}'; base-uri 'none'; form-action 'none'"
        ),
        "style": style,
        "script": script,
        "title": ascii_html(f"{name_of(folder.rstrip('/')) or folder}: {len(records)} morphs"),
        "summary": f"{len(done)} done, {n_failed} failed.",
        "header": "".join(_head(kind, title) for kind, title in heads),
        "rows": "".join(_row(folder, record) for record in records),
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: slots[found[1]], _resource("index.html"))


def _head(kind: str, title: str) -> str:
    shown = ascii_html(title)
    button = f'<button type="button">{shown}</button>' if kind else shown
    return f'<th scope="col" data-kind="{kind}">{button}</th>'


def _row(folder: str, record: Mapping[str, Any]) -> str:
    status = str(record["status"])
    link, name = _link(folder, str(record["output"]))
    is_done = status == "done"
    cells = [f'<td><a href="{link}">{name}</a></td>' if is_done else f"<td>{name}</td>"]
    thumbnail = str(record.get("thumbnail", ""))
    # A journal can be edited by anybody: nothing but a JPEG is shown.
    fine = re.fullmatch(r"data:image/jpeg;base64,[A-Za-z0-9+/=]+", thumbnail)
    cells.append(f'<td><img alt="" src="{thumbnail}"></td>' if fine else "<td></td>")
    shown = "not converged" if is_done and record.get("solver") != "converged" else status
    cells.append(f"<td>{ascii_html(shown)}</td>")
    for key, _, form in NUMBERS:
        value = record.get(key)
        if not isinstance(value, int | float) or not math.isfinite(value):
            cells.append('<td class="number" data-value=""></td>')
            continue
        if form in ("", "{:d}"):
            value = int(value)
        text = form.format(value) if form else size_text(int(value))
        cells.append(f'<td class="number" data-value="{value!r}">{ascii_html(text)}</td>')
    cells.append(f'<td class="device">{ascii_html(str(record.get("device", "")))}</td>')
    cells.append(f'<td class="line">{ascii_html(str(record.get("line", "")))}</td>')
    return f'<tr class="{"done" if is_done else "failed"}">{"".join(cells)}</tr>\n'


def _link(folder: str, output: str) -> tuple[str, str]:
    """Return the address of an output from the page, and its name."""
    if is_remote(output) or is_remote(folder):
        start = folder.rstrip("/") + "/"
        name = output.removeprefix(start)
        return (quote(name) if output.startswith(start) else escape(output)), ascii_html(name)
    try:
        name = Path(os.path.relpath(output, folder)).as_posix()
    except ValueError:  # on another drive
        return escape(Path(output).as_uri()), ascii_html(output)
    return escape(quote(os.fsencode(name))), ascii_html(name)


def _resource(name: str) -> str:
    return files("clmorph.batch").joinpath(name).read_text(encoding="ascii")
