"""``.npz``: a morph as NumPy arrays, for further computation."""

import zipfile
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clmorph._shared.printable import reason_of, size_text
from clmorph._shared.progress import Report, tracked
from clmorph._shared.typing import Array
from clmorph._shared.validation import check_number, is_path, shown
from clmorph.errors import InputError
from clmorph.output.bounded import MAX_HEAD, UNREADABLE, Arrays, from_text
from clmorph.output.formats.format import Format
from clmorph.output.formats.solved import RECORD, plan_is_valid, put_together, taken_apart
from clmorph.output.metadata import as_text
from clmorph.output.options import FrameStyle
from clmorph.output.recording import Recording
from clmorph.transport.barycentric import Barycentric
from clmorph.transport.plan import Plan

#: Names of the arrays of either kind of plan, each with its number of axes and kind of dtype.
PLAN_ARRAYS = {
    "indptr": (1, "i"), "indices": (1, "i"), "mass": (1, "f"), "shape": (1, "i"),
    "whole_row_mass": (1, "f"), "whole_column_mass": (1, "f"),
}  # fmt: skip
BARYCENTRIC_ARRAYS = {
    "positions": (2, "f"), "colors": (2, "f"), "covariance": (3, "f"), "row_mass": (1, "f"),
    "column_mass": (1, "f"),
}  # fmt: skip
#: The default limit of the memory that the arrays of an archive may take, in bytes.
MAX_BYTES = 2 * 2.0**30


@dataclass(frozen=True, repr=False, eq=False)
class Archive:
    """A morph that was saved as ``.npz``, loaded again.

    Attributes
    ----------
    frames : list of (H, W, 3) or (H, W, 4) float32 arrays
        sRGB in [0, 1].
    times : (n,) array
    parameters : dict
        The options that the morph was made with.
    plans : list of Plan or Barycentric
        One for each morph of a chain.
    potentials : list of (f, g)
        One pair for each morph of a chain, in units of the cost.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     morph.save(Path(folder) / "out.npz")
    ...     archive = clmorph.load(Path(folder) / "out.npz")
    >>> archive
    <Archive of 5 frames, 1 plans>
    >>> len(archive.plan) == len(morph.plan)
    True
    """

    frames: list[NDArray[np.float32]]
    times: Array
    parameters: dict[str, Any]
    plans: list[Plan | Barycentric]
    potentials: list[tuple[Array, Array]]

    def __repr__(self) -> str:
        return f"<Archive of {len(self.frames)} frames, {len(self.plans)} plans>"

    @property
    def plan(self) -> Plan | Barycentric:
        """The plan of the only, or the first, morph."""
        return self.plans[0]


def write(recording: Recording, style: FrameStyle, file: Path, report: Report) -> None:
    """Write frames (floats), times, parameters, and the plan and potentials of each morph."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive:
        _write_frames(archive, recording, report)
        _write_array(archive, "times", recording.times)
        _write_array(archive, "parameters", np.array(as_text(recording.parameters)))
        for number, morph in enumerate(recording.morphs):
            _write_array(archive, f"f_{number}", morph.potentials.f)
            _write_array(archive, f"g_{number}", morph.potentials.g)
            names = PLAN_ARRAYS if isinstance(morph.plan, Plan) else BARYCENTRIC_ARRAYS
            for name in names:
                _write_array(archive, f"plan_{number}_{name}", getattr(morph.plan, name))


def _write_frames(archive: zipfile.ZipFile, recording: Recording, report: Report) -> None:
    """Write frames one by one, so that they need not all be in memory."""
    indices = range(len(recording))
    if len(set(recording.shapes)) > 1:
        digits = max(4, len(str(len(recording) - 1)))
        for index in tracked(indices, report):
            _write_array(archive, f"frame_{index:0{digits}d}", recording.frames[index])
        return
    first = recording.frames[0]
    descr, shape = np.lib.format.dtype_to_descr(first.dtype), (len(recording), *first.shape)
    header = {"descr": descr, "fortran_order": False, "shape": shape}
    with archive.open(_entry("frames"), "w", force_zip64=True) as stream:
        np.lib.format.write_array_header_1_0(stream, header)
        for index in tracked(indices, report):
            stream.write(np.ascontiguousarray(recording.frames[index]).tobytes())


def _entry(name: str) -> zipfile.ZipInfo:
    """Return an entry of the archive with a fixed date, so that equal morphs give equal bytes."""
    entry = zipfile.ZipInfo(f"{name}.npy")
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry


def _write_array(archive: zipfile.ZipFile, name: str, array: Any) -> None:
    with archive.open(_entry(name), "w", force_zip64=True) as stream:
        np.lib.format.write_array(stream, np.asarray(array), allow_pickle=False)


def write_solved(value: Any, file: Path) -> None:
    """Write a result of the solver."""
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, allowZip64=True) as archive:
        for name, array in taken_apart(value).items():
            _write_array(archive, name, array)


def load(path: str | PathLike[str], *, max_bytes: float = MAX_BYTES) -> Any:
    """Load a morph, or a result of the solver, that was saved as ``.npz``.

    Nothing in the file is executed, and the sizes of its arrays are checked before they are read.
    So a file from an unknown source can be refused, but cannot take more memory than `max_bytes`.

    Parameters
    ----------
    path : path
    max_bytes : float
        The limit of the memory that its arrays may take, in bytes; by default 2 GiB. 30 frames
        of 1280 x 720 pixels take 0.33 GB.

    Returns
    -------
    Archive, or Potentials, Plan, Divergence, PotentialsBatch or Assignment
        What was saved. Potentials come without `measures`.

    Raises
    ------
    InputError
        If the file cannot be read, was not written by clmorph, or its arrays exceed `max_bytes`.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import clmorph
    >>> import numpy as np
    >>> left, right = np.zeros((2, 6, 6, 3))
    >>> left[:, :3] = right[:, 3:] = 1.0
    >>> morph = clmorph.morph(left, right, n_frames=5, backend="numpy")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     morph.save(Path(folder) / "out.npz")
    ...     archive = clmorph.load(Path(folder) / "out.npz")
    >>> bool(np.array_equal(archive.frames[2], morph[2]))
    True
    """
    if not is_path(path):
        raise InputError(f"path={shown(path)}: expected the path of a morph saved as .npz")
    max_bytes = check_number("max_bytes", max_bytes, 1.0, 1e18)
    try:
        with Arrays(Path(path), max_bytes=max_bytes) as arrays:
            size = sum(map(arrays.size, arrays.names))
            if size > max_bytes:
                raise InputError(
                    f"{path}: its arrays take {size_text(size)}, expected at most "
                    f"{size_text(max_bytes)}; if you trust the file, load it with "
                    f"max_bytes={size}"
                )
            return put_together(arrays) if RECORD in arrays.names else _read(arrays)
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason_of(error)})") from None
    except (*UNREADABLE, RecursionError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path}: not a morph or result saved as .npz, or damaged ({reason_of(error)}); "
            "expected a file that clmorph has written"
        ) from None


def _read(arrays: Arrays) -> Archive:
    if "frames" in arrays.names:
        frames = list(arrays.read("frames", 4))
    else:
        names = sorted(name for name in arrays.names if name.startswith("frame_"))
        frames = [arrays.read(name, 3) for name in names]
    times = arrays.read("times", 1)
    if len(frames) != len(times) or any(frame.shape[2] not in (3, 4) for frame in frames):
        raise ValueError("its frames are not those of its times")
    parameters = from_text(arrays.text("parameters"))
    if not isinstance(parameters, dict):
        raise ValueError("its parameters are not a mapping")
    n_morphs = sum(name.startswith("f_") for name in arrays.names)
    plans = [_read_plan(arrays, number) for number in range(n_morphs)]
    potentials = [
        (arrays.read(f"f_{number}", 1), arrays.read(f"g_{number}", 1)) for number in range(n_morphs)
    ]
    return Archive(frames, times, parameters, plans, potentials)


def _read_plan(arrays: Arrays, number: int) -> Plan | Barycentric:
    start = f"plan_{number}_"
    kinds = PLAN_ARRAYS if f"{start}indptr" in arrays.names else BARYCENTRIC_ARRAYS
    found: dict[str, Any] = {name: arrays.read(start + name, *kinds[name]) for name in kinds}
    if kinds is BARYCENTRIC_ARRAYS:
        return Barycentric(**found)
    rows, columns = (int(side) for side in found.pop("shape"))
    plan = Plan(**found, shape=(rows, columns))
    if not plan_is_valid(plan):
        raise ValueError("its plan is not valid")
    return plan


def read_metadata(path: Path) -> str:
    """Return the metadata text of an archive: its array ``parameters``."""
    with Arrays(path, max_bytes=MAX_HEAD) as arrays:
        return arrays.text("parameters")


FORMATS = (
    Format(
        name="npz", endings=(".npz",), write=write, read_metadata=read_metadata,
        signatures=((0, b"PK"),), exact=True, keep=True, relevant_options=(),
    ),
)  # fmt: skip
