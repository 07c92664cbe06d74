"""``.npz``: a morph as NumPy arrays, to go on with."""

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph.checks import is_path, shown
from clmorph.errors import InputError
from clmorph.film import Film
from clmorph.formats.embedding import UNREADABLE, as_text
from clmorph.framing import Look
from clmorph.plan import Plan
from clmorph.progress import Report, tracked
from clmorph.sampling import Barycentric

#: Arrays of either kind of plan, as they are called there.
PLAN_ARRAYS = ("indptr", "indices", "mass", "shape", "whole_row_mass")
BARYCENTRIC_ARRAYS = ("positions", "colors", "covariance", "row_mass", "column_mass")


@dataclass(frozen=True, repr=False, eq=False)
class Archive:
    """A morph that was saved as ``.npz``, loaded again.

    Attributes
    ----------
    frames : list of (H, W, 3) or (H, W, 4) float32 arrays
        sRGB in [0, 1].
    times : (n,) array
    parameters : dict
        What it was made with.
    plans : list of Plan or Barycentric
        One for each morph of a chain.
    potentials : list of (f, g)
        Likewise; cost units.
    """

    frames: list[NDArray[np.float32]]
    times: NDArray[np.float64]
    parameters: dict[str, Any]
    plans: list[Plan | Barycentric]
    potentials: list[tuple[NDArray[np.float64], NDArray[np.float64]]]

    def __repr__(self) -> str:
        return f"<Archive of {len(self.frames)} frames, {len(self.plans)} plans>"

    @property
    def plan(self) -> Plan | Barycentric:
        """The plan of the only, or the first, morph."""
        return self.plans[0]


def write(film: Film, look: Look, file: Path, report: Report) -> None:
    """Write frames (floats), times, parameters, and the plan and potentials of each morph.

    Frames of one size are one array ``frames`` (n, H, W, C); others are ``frame_0000`` and so
    on.
    """
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive:
        _write_frames(archive, film, report)
        _write_array(archive, "times", film.times)
        _write_array(archive, "parameters", np.array(as_text(film.parameters)))
        for number, morph in enumerate(film.morphs):
            _write_array(archive, f"f_{number}", morph.potentials.f)
            _write_array(archive, f"g_{number}", morph.potentials.g)
            names = PLAN_ARRAYS if isinstance(morph.plan, Plan) else BARYCENTRIC_ARRAYS
            for name in names:
                _write_array(archive, f"plan_{number}_{name}", getattr(morph.plan, name))


def _write_frames(archive: zipfile.ZipFile, film: Film, report: Report) -> None:
    """Write frames one by one: they need not all be in memory."""
    indices = range(len(film))
    if len(set(film.shapes)) > 1:
        digits = max(4, len(str(len(film) - 1)))
        for index in tracked(indices, report):
            _write_array(archive, f"frame_{index:0{digits}d}", film.frames[index])
        return
    first = film.frames[0]
    header = {
        "descr": np.lib.format.dtype_to_descr(first.dtype),
        "fortran_order": False,
        "shape": (len(film), *first.shape),
    }
    with archive.open(_entry("frames"), "w", force_zip64=True) as stream:
        np.lib.format.write_array_header_1_0(stream, header)
        for index in tracked(indices, report):
            stream.write(np.ascontiguousarray(film.frames[index]).tobytes())


def _entry(name: str) -> zipfile.ZipInfo:
    """Return a file of the archive; without today's date, so that bytes can be the same."""
    entry = zipfile.ZipInfo(f"{name}.npy")
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def _write_array(archive: zipfile.ZipFile, name: str, array: Any) -> None:
    with archive.open(_entry(name), "w", force_zip64=True) as stream:
        np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)


def load(path: str | PathLike[str]) -> Archive:
    """Load a morph that was saved as ``.npz``.

    Parameters
    ----------
    path : path

    Returns
    -------
    Archive

    Raises
    ------
    InputError
        If the file cannot be read, or is another's.
    """
    if not is_path(path):
        raise InputError(f"path={shown(path)}: expected the path of a morph saved as .npz")
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            if "frames" in archive:
                frames: Sequence[NDArray[np.float32]] = archive["frames"]
            else:
                frames = [archive[name] for name in sorted(archive) if name.startswith("frame_")]
            n_morphs = sum(name.startswith("f_") for name in archive)
            return Archive(
                list(frames), archive["times"], json.loads(str(archive["parameters"])),
                [_read_plan(archive, number) for number in range(n_morphs)],
                [(archive[f"f_{number}"], archive[f"g_{number}"]) for number in range(n_morphs)],
            )  # fmt: skip
    except UNREADABLE as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{path}: not a morph saved as .npz, or damaged ({reason}); expected a file that "
            "clmorph has written"
        ) from None


def _read_plan(archive: Any, number: int) -> Plan | Barycentric:
    start = f"plan_{number}_"
    if f"{start}indptr" in archive:
        arrays = {name: archive[start + name] for name in PLAN_ARRAYS}
        height, width = (int(side) for side in arrays["shape"])
        return Plan(**(arrays | {"shape": (height, width)}))
    return Barycentric(**{name: archive[start + name] for name in BARYCENTRIC_ARRAYS})
