"""The source distributions that contain the libraries' tests, with pinned versions and digests."""

import hashlib
import subprocess
import sys
import tarfile
from pathlib import Path
from typing import NamedTuple


class Sdist(NamedTuple):
    """A source distribution, and the test files in it that are run."""

    package: str
    version: str
    tests: tuple[str, ...]
    sha256: str


#: POT moved its tests of unbalanced transport to a folder that its sdists leave out after 0.9.4:
#: those of that version are run on the installed one. GeomLoss's sdist holds its test modules
#: without their problems, so POT's tests of it are run. None of OTT-JAX's holds a test (0.1.0 to
#: 0.6.0: six of them were looked at).
SDISTS: dict[str, tuple[Sdist, ...]] = {
    "pot": (
        Sdist(
            "POT", "0.9.4", ("test/test_unbalanced.py",),
            "4cf8b46bf4992c37529161c32dd5e3334e0c089399142f08ed6d455b57015edd",
        ),
        Sdist(
            "POT", "0.9.7.post1",
            (
                "test/test_bregman.py", "test/test_solvers.py", "test/test_optim.py",
                "test/test_smooth.py", "test/test_stochastic.py", "test/test_da.py",
            ), "2edd70845047ac2d378487b980a2bffb5ff58e9b92b7133896ff5753f6300cec",
        ),
    ),
    "geomloss": (),
    "ott": (),
}  # fmt: skip


class SourceError(Exception):
    """A source distribution could not be had, or is another one."""


def fetch(sdist: Sdist, cache: Path) -> Path:
    """Return the folder of an unpacked source distribution, fetched by pip where it is missing.

    Raises
    ------
    SourceError
        If pip does not get it, or its digest is another.
    """
    folder = cache / f"{sdist.package}-{sdist.version}"
    archives = folder / "archive"
    archives.mkdir(parents=True, exist_ok=True)
    found = sorted(archives.glob("*.tar.gz"))
    if not found:
        command = [
            sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary",
            sdist.package, "--dest", str(archives), f"{sdist.package}=={sdist.version}",
        ]  # fmt: skip
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        found = sorted(archives.glob("*.tar.gz"))
        if not found:
            last = (done.stderr.strip() or "no archive").splitlines()[-1]
            raise SourceError(f"{sdist.package} {sdist.version}: pip got no sdist: {last}")
    digest = hashlib.sha256(found[0].read_bytes()).hexdigest()
    if digest != sdist.sha256:
        raise SourceError(
            f"{found[0]}: its SHA-256 is {digest}, expected {sdist.sha256}; delete it, so that "
            "it is fetched again"
        )
    root = folder / "source"
    if not root.exists():
        with tarfile.open(found[0]) as archive:
            archive.extractall(root, filter="data")
    return next(root.iterdir())
