"""The table of jobs: a CSV or JSON file, all pairs of a folder, or a chain through a folder."""

import csv
import io
import itertools
import json
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clmorph._shared.options import by_outside_name, from_line, unknown_option
from clmorph._shared.printable import printable
from clmorph._shared.validation import errors_about, shown
from clmorph.batch.places import INDEX, JOURNAL, file_identity, name_of, read_bytes, resolved
from clmorph.errors import FileError, InputError
from clmorph.output.formats.registry import by_ending, usual_endings
from clmorph.pipeline.options import MorphOptions
from clmorph.pipeline.presets import AUTO, PRESETS
from clmorph.pipeline.recipe import PRESET, options_of

#: Columns that each job has.
COLUMNS = ("source", "target", "output")
#: Columns of files beside the pictures, two of a kind or none.
BESIDE = {
    "labels": ("source_labels", "target_labels"),
    "features": ("source_features", "target_features"),
}
_TEXTS = (*COLUMNS, *(name for names in BESIDE.values() for name in names))
_WANTED = f"{', '.join(COLUMNS)} and any option of clmorph morph"
#: Words of a CSV file for truth values.
FLAGS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}
#: Endings of pictures that are taken from a folder.
PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".tif", ".tiff", ".ppm")


@dataclass(frozen=True)
class Defaults:
    """What holds for all jobs: the folder of outputs, and the file of settings."""

    folder: str
    options: Mapping[str, Any]
    preset: str | None
    max_pixels: int


@dataclass(frozen=True)
class Job:
    """One morph of a batch."""

    #: The place of the job in its table, for messages.
    where: str
    #: Absolute paths, or such as fsspec opens; `target` and `output` too.
    source: str
    target: str
    output: str
    defaults: Defaults
    #: Options of the row, by their names in Python.
    options: Mapping[str, Any] = field(default_factory=dict)
    #: The preset that the row names, which then wins over the defaults.
    own_preset: str | None = None
    #: Absolute paths of the label images and of the features of both pictures, by these words.
    beside: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def read(self) -> list[str]:
        """The files that the job reads."""
        return [self.source, self.target, *(place for two in self.beside.values() for place in two)]

    @property
    def preset(self) -> str | None:
        """The preset of the row or of the defaults; None if the pictures choose it."""
        chosen = self.defaults.preset if self.own_preset is None else self.own_preset
        return None if chosen == AUTO else chosen

    def settled(self, preset: str | None) -> MorphOptions:
        """Return the options of the morph, as ``clmorph morph`` joins them."""
        return MorphOptions.joined(
            self.options, preset, self.defaults.options, preset_wins=self.own_preset is not None
        )


def read_jobs(place: str, defaults: Defaults) -> list[Job]:
    """Return the jobs of a CSV or JSON file, which pictures are relative to, or raise FileError."""
    ending = name_of(place).rpartition(".")[2].lower()
    if ending not in ("csv", "json"):
        raise InputError(f"{place}: expected a table of jobs: .csv or .json")
    try:
        text = read_bytes(place).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise FileError(f"{place}: not UTF-8; save the table as UTF-8") from None
    rows = list(_csv_rows(place, text) if ending == "csv" else _json_rows(place, text))
    if not rows:
        raise FileError(f"{place}: it holds no jobs; expected rows of {', '.join(COLUMNS)}")
    base = _folder_of(place)
    jobs = [_job(where, row, options, base, defaults) for where, row, options in rows]
    return checked(jobs, defaults.folder)


def _csv_rows(place: str, text: str) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    reader = csv.DictReader(io.StringIO(text, newline=""), strict=True)
    try:
        header = [name.strip() for name in reader.fieldnames or ()]
        _check_columns(f"{place} line 1", header)
        reader.fieldnames = [_plain(name) for name in header]
        for row in reader:
            where = f"{place} line {reader.line_num}"
            if None in row:
                raise FileError(f"{where}: more values than the {len(header)} columns")
            if None in row.values():
                raise FileError(f"{where}: fewer values than the {len(header)} columns")
            given = {name: value.strip() for name, value in row.items() if value.strip()}
            if given:
                yield where, given, _from_texts(where, given, _folder_of(place))
    except csv.Error as error:
        raise FileError(f"{place} line {reader.line_num}: not CSV ({error})") from None


def _json_rows(place: str, text: str) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    try:
        entries = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise FileError(f"{place}: not JSON ({printable(error, 120)})") from None
    if not isinstance(entries, list):
        raise FileError(f'{place}: expected a list of jobs, as [{{"source": …}}, …]')
    for number, entry in enumerate(entries, 1):
        where = f"{place} entry {number}"
        if not isinstance(entry, dict):
            raise FileError(f"{where}: {shown(entry)}: expected an object with {_WANTED}")
        _check_columns(where, list(entry))
        entry = {_plain(name): value for name, value in entry.items()}
        for name in _TEXTS:
            if name in entry and not isinstance(entry[name], str):
                raise FileError(f"{where}: {name} = {shown(entry[name])}: expected a text")
        others = {name: value for name, value in entry.items() if name not in _TEXTS}
        try:
            yield where, entry, options_of(others, where)
        except InputError as error:
            raise FileError(str(error)) from None


def _plain(name: str) -> str:
    """Return the name of a column without dashes."""
    return name.replace("-", "_")


def _folder_of(place: str) -> str:
    """Return the folder of a table."""
    return place.rpartition("/")[0] if "://" in place else str(Path(place).parent)


def _check_columns(where: str, names: list[str]) -> None:
    plains = [_plain(name) for name in names]
    known = dict.fromkeys((*_TEXTS, PRESET, *by_outside_name(MorphOptions)))
    missing = [name for name in COLUMNS if name not in plains]
    if missing:
        raise FileError(f"{where}: no column {' and '.join(missing)}; expected {_WANTED}")
    for number, name in enumerate(names):
        plain = plains[number]
        if plain in plains[:number]:
            raise FileError(f"{where}: two columns {shown(name)}")
        if plain not in known:
            raise FileError(f"{where}: {unknown_option(name, known)}")


def _from_texts(where: str, row: Mapping[str, str], base: str) -> dict[str, Any]:
    """Return the options of a row of CSV, by their names in Python; `base` is its folder."""
    names = by_outside_name(MorphOptions)
    found: dict[str, Any] = {}
    for plain, text in row.items():
        if plain == PRESET:
            found[PRESET] = text
        elif plain in names:
            name, each = names[plain]
            with errors_about(f"{where}: {plain}", FileError):
                flag = not each.kind.metavar
                if flag and text.lower() not in FLAGS:
                    raise InputError(f"{shown(text)}: expected true or false")
                # A file of landmarks is relative to the table, as pictures are.
                if plain == "landmark" and text.lower().endswith((".csv", ".txt")):
                    text = resolved(text, base)
                found[name] = FLAGS[text.lower()] if flag else from_line(each, text)
    return found


def _job(
    where: str, row: Mapping[str, Any], options: dict[str, Any], base: str, defaults: Defaults
) -> Job:
    for name in COLUMNS:
        if not row.get(name) or "\0" in row[name]:
            raise FileError(f"{where}: no {name}; expected {_WANTED}")
    preset = options.pop(PRESET, None)
    if preset is not None and preset not in (AUTO, *PRESETS):
        names = ", ".join(map(repr, (AUTO, *PRESETS)))
        raise FileError(f"{where}: preset = {shown(preset)}: expected one of {names}")
    source, target = (resolved(row[name], base) for name in COLUMNS[:2])
    output = resolved(row["output"], defaults.folder)
    beside: dict[str, tuple[str, str]] = {}
    for kind, columns in BESIDE.items():
        given = [row[name] for name in columns if row.get(name)]
        if len(given) == 1 or any("\0" in each for each in given):
            raise FileError(f"{where}: expected both {' and '.join(columns)}, or none of them")
        if given:
            beside[kind] = resolved(given[0], base), resolved(given[1], base)
    return Job(where, source, target, output, defaults, options, preset, beside)


def from_folder(folder: str, ending: str, chain: bool, defaults: Defaults) -> list[Job]:
    """Return jobs between a folder's pictures by name: all pairs, one way, or a `chain`."""
    try:
        found = sorted(Path(folder).iterdir())
    except OSError as error:
        raise FileError(f"{folder}: expected a folder ({error.strerror})") from None
    pictures = [path for path in found if path.suffix.lower() in PICTURES and path.is_file()]
    if len(pictures) < 2:
        raise InputError(f"{folder} holds {len(pictures)} pictures: expected two or more")
    if ending.lower() in PICTURES and file_identity(folder) == file_identity(defaults.folder):
        raise InputError(
            f"{folder}: {ending} files would count as pictures when the same command goes on; "
            "choose another folder of outputs"
        )
    ambiguous = len({path.stem for path in pictures}) < len(pictures)
    jobs = []
    pairs = itertools.pairwise(pictures) if chain else itertools.combinations(pictures, 2)
    together = list(pairs)
    names = [[path.name if ambiguous else path.stem for path in pair] for pair in together]
    # Names with dashes of their own can make two pairs look the same.
    apart = next(
        (dashes for dashes in ("-", "--", "---")
         if len({dashes.join(each) for each in names}) == len(names)), "-",
    )  # fmt: skip
    for (source, target), each in zip(together, names, strict=True):
        output = resolved(f"{apart.join(each)}{ending}", defaults.folder)
        where = f"{source.name} and {target.name}"
        first, second = (resolved(str(path)) for path in (source, target))
        jobs.append(Job(where, first, second, output, defaults))
    return checked(jobs, defaults.folder)


def from_pairs(pairs: Iterable[Any], defaults: Defaults) -> list[Job]:
    """Return the jobs of tuples (source, target, output), or raise InputError."""
    jobs = []
    try:
        items = list(pairs)
    except Exception:  # foreign types can raise any exception
        raise InputError(f"pairs={shown(pairs)}: expected a list of paths {_TUPLE}") from None
    for number, item in enumerate(items):
        if not (
            isinstance(item, tuple | list)
            and len(item) == len(COLUMNS)
            and all(isinstance(part, str | Path) and str(part) for part in item)
        ):
            raise InputError(f"pairs[{number}] = {shown(item)}: expected paths {_TUPLE}")
        source, target, output = (resolved(str(part)) for part in item)
        jobs.append(Job(f"pairs[{number}]", source, target, output, defaults))
    return checked(jobs)


_TUPLE = f"({', '.join(COLUMNS)})"


def checked(jobs: list[Job], folder: str | None = None) -> list[Job]:
    """Return jobs with usable options, and outputs that replace no other, picture or own file."""
    for job in jobs:
        with errors_about(job.where, FileError):
            job.settled(job.preset)
        if by_ending(Path(name_of(job.output))) is None:
            raise FileError(
                f"{job.where}: {name_of(job.output)}: unknown ending; expected "
                f"{', '.join(usual_endings())}"
            )
    read = {file_identity(place) for job in jobs for place in job.read}
    own = () if folder is None else (INDEX, JOURNAL)
    reserved = {file_identity(resolved(name, folder or "")) for name in own}
    first: dict[Hashable, str] = {}
    for job in jobs:
        identity, name = file_identity(job.output), name_of(job.output)
        if identity in first:
            raise FileError(f"{job.where}: {name} is the output of {first[identity]}, too")
        if identity in read:
            raise FileError(f"{job.where}: {name} would replace a picture")
        if identity in reserved:
            raise FileError(f"{job.where}: {name} is a file of the batch itself; choose another")
        first[identity] = job.where
    return jobs
