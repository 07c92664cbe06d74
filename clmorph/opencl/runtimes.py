"""Make OpenCL runtimes that were installed with pip visible to the OpenCL loader.

Intel's wheel leaves its registration file with a placeholder path, so no loader finds
the runtime by itself. Which runtimes a process sees is settled at its first platform
query; `register_pip_runtimes` must therefore run before that, and hides nothing that was
visible without it.
"""

import contextlib
import hashlib
import os
import sys
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import platformdirs

from clmorph.opencl.storage import cache_folder, write_atomically

#: Where a Linux loader looks by default.
SYSTEM_VENDORS = Path("/etc/OpenCL/vendors")


def import_pyopencl() -> None:
    """Import pyopencl, without its caches where their folder cannot be written to.

    Raises
    ------
    ImportError
        If it is not installed or cannot be loaded.
    """
    if "pyopencl" not in sys.modules:
        try:
            Path(platformdirs.user_cache_dir("pytools", "pytools")).mkdir(
                parents=True, exist_ok=True
            )
        except OSError:
            os.environ.setdefault("PYOPENCL_NO_CACHE", "1")
    import pyopencl  # noqa: F401


def intel_runtime() -> Path | None:
    """Find the CPU runtime of the `intel-opencl-rt` wheel.

    Returns
    -------
    Path or None
        The shared library, or None if the wheel or the math library that its compiler
        needs (`intel-cmplr-lib-rt`) is not installed for this interpreter.
    """
    try:
        files = metadata.distribution("intel-opencl-rt").files or []
    except metadata.PackageNotFoundError:
        return None
    for file in files:
        if file.name == "libintelocl.so":
            library = Path(str(file.locate())).resolve()
            # Without libsvml the runtime cannot even be loaded.
            if library.exists() and (library.parent / "libsvml.so").exists():
                return library
    return None


def _bundled_entries(pyopencl_folder: Path) -> dict[str, str]:
    """Registration entries of pyopencl's own wheel, with absolute library paths."""
    libraries = pyopencl_folder / ".libs"
    entries = {}
    for entry in sorted(libraries.glob("*.icd")):
        library = libraries / entry.read_text().strip()
        if library.exists():
            entries[entry.name] = str(library)
    return entries


def _vendor_folder(entries: dict[str, str]) -> Path:
    """Write the registration entries into a folder of their own and return its parent."""
    digest = hashlib.sha256(repr(sorted(entries.items())).encode()).hexdigest()[:16]
    try:
        home = cache_folder() / "icd" / digest
        (home / ".libs").mkdir(parents=True, exist_ok=True)
        for name, library in entries.items():
            write_atomically(home / ".libs" / name, library + "\n")
    except OSError:
        home = Path(tempfile.mkdtemp(prefix="clmorph-icd-"))
        (home / ".libs").mkdir()
        for name, library in entries.items():
            (home / ".libs" / name).write_text(library + "\n")
    return home


@contextlib.contextmanager
def register_pip_runtimes() -> Iterator[None]:
    """Show pip's runtimes to the loader while the first platform query runs.

    A value of ``OCL_ICD_VENDORS`` that the user has set is respected: nothing is added.
    The wheels of pyopencl bring a loader that reads ``$PYOPENCL_HOME/.libs`` in addition
    to the system's folder; with any other loader the system's entries are carried into a
    folder that ``OCL_ICD_VENDORS`` then names.
    """
    import pyopencl

    library = intel_runtime() if sys.platform == "linux" else None
    if library is None or "OCL_ICD_VENDORS" in os.environ:
        yield
        return
    package = Path(pyopencl.__file__).parent
    entries = {"intel-cpu.icd": str(library)} | _bundled_entries(package)
    if any((package / ".libs").glob("libOpenCL*")):
        variable = "PYOPENCL_HOME"
        value = _vendor_folder(entries)
    else:
        variable = "OCL_ICD_VENDORS"
        for entry in sorted(SYSTEM_VENDORS.glob("*.icd")):
            entries.setdefault(entry.name, entry.read_text().strip())
        value = _vendor_folder(entries) / ".libs"
    before = os.environ.get(variable)
    os.environ[variable] = str(value)
    try:
        yield
    finally:
        if before is None:
            del os.environ[variable]
        else:
            os.environ[variable] = before
