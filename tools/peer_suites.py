"""Run POT's, GeomLoss's and OTT-JAX's tests of entropic transport with clmorph in their place.

    python tools/peer_suites.py pot geomloss ott --device numpy
    python tools/peer_suites.py pot --device 0:0 --markdown
    python tools/peer_suites.py ott --tests ott=CHECKOUT/tests

The tests come from the libraries' source distributions, by pip, at versions and digests that
`peers/sources.py` pins; nothing of them is kept here. Each library is the installed one, with
its solvers replaced by adapters (`peers/adapter_pot.py` and so on), and every
test ends as one of:

    passed           clmorph was called, and the test's own checks hold
    failed           they do not
    not applicable   with the reason: another problem, a gradient, a cost of a high rank, ...
    not exercised    the test passed without a call of clmorph: it says nothing

A solver that is replaced has no way back to the library's own. The interpreter that runs this
needs clmorph, pytest and the libraries: `pip install -e .[peers]`, best in an
environment of its own. Exit codes: 0 nothing failed; 1 a test failed, or none of a suite called
clmorph; 2 a mistake in the command line, or no sdist to be had.
"""

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from peers import outcomes, sources

TOOLS = Path(__file__).resolve().parent
LIBRARIES = {"pot": "ot", "geomloss": "geomloss", "ott": "ott"}
#: POT's tests that call `solve_sample`.
INTERFACE_TESTS = (
    "test_solve_sample", "test_solve_sample_lazy", "test_solve_sample_debias",
    "test_solve_sample_NotImplemented",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("libraries", nargs="*", help=f"of {', '.join(LIBRARIES)} [default: all]")
    parser.add_argument("--device", default="numpy", help="clmorph's backend [default: numpy]")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "clmorph-peers",
                        help="folder of the source distributions")  # fmt: skip
    parser.add_argument("--tests", action="append", default=[], metavar="LIBRARY=FOLDER",
                        help="run the tests of a checkout as well")  # fmt: skip
    parser.add_argument("--select", default="", help="pytest's -k")
    parser.add_argument("--markdown", action="store_true", help="print tables in Markdown")
    parser.add_argument("--verbose", action="store_true", help="show what pytest prints")
    given = parser.parse_args(arguments)
    libraries = given.libraries or list(LIBRARIES)
    for library in libraries:
        if library not in LIBRARIES:
            parser.error(f"{library!r}: expected one of {', '.join(LIBRARIES)}")
        if importlib.util.find_spec(LIBRARIES[library]) is None:
            parser.error(f"{library} is not installed here: pip install -e .[peers]")
    folders = [text.partition("=") for text in given.tests]
    for library, _, folder in folders:
        if library not in libraries or not Path(folder).is_dir():
            parser.error(f"--tests {library}={folder}: expected LIBRARY=FOLDER of a checkout")
    extra = {library: Path(folder).resolve() for library, _, folder in folders}
    found: dict[str, list[outcomes.Outcome]] = {}
    with tempfile.TemporaryDirectory() as work:
        try:
            for library in libraries:
                suites = make_suites(library, given.cache, extra.get(library))
                for name, adapter, fixtures, root, files in suites:
                    found[name] = run(
                        (library, adapter, fixtures), given.device, root, files,
                        Path(work) / "report.jsonl", given.select, given.verbose,
                    )  # fmt: skip
                    for each in found[name]:
                        if each.outcome == "failed":
                            print(f"FAILED {name}: {each.test}\n{each.reason}", file=sys.stderr)
        except sources.SourceError as error:
            print(f"peer_suites: error: {error}", file=sys.stderr)
            return 2
    print(f"device: {given.device}")
    print(outcomes.summary(found, given.markdown))
    return max(outcomes.verdict(each) for each in found.values())


Suite = tuple[str, str, str, Path, list[Path]]


def make_suites(library: str, cache: Path, extra: Path | None) -> list[Suite]:
    """Return name, adapter, fixtures, root and files of each suite of a library."""
    fixtures = "pot_fixtures" if library == "pot" else ""
    suites: list[Suite] = []
    for sdist in sources.SDISTS[library]:
        root = sources.fetch(sdist, cache)
        files = [root / test for test in sdist.tests]
        suites.append((f"{sdist.package} {sdist.version}", library, fixtures, root, files))
    cases = TOOLS / "peers"
    if library == "pot":
        # Both sides of each comparison are called by name: nothing is replaced.
        suites.append(("POT: problems of ours", "", "", cases, [cases / "pot_cases.py"]))
        suites += [
            ("POT's tests of solve_sample, by our interface", "pot_interface", fixtures, root,
             [root / "test" / f"test_solvers.py::{test}" for test in INTERFACE_TESTS]),
            ("POT: lazy and unbalanced, which it refuses", "", "", cases,
             [cases / "pot_interface_cases.py"]),
        ]  # fmt: skip
    if library == "ott":
        # It puts the adapter in place itself, to have OTT's own answers as well.
        suites.append(("OTT-JAX: problems of ours", "", "", cases, [cases / "ott_cases.py"]))
    if library == "geomloss":
        # Its own sdist holds tests without their problems. POT's tests of it compare
        # `SamplesLoss` with POT's own solver.
        pot = sources.SDISTS["pot"][-1]
        root = sources.fetch(pot, cache)
        files = [root / "test" / "test_bregman.py"]
        suites.append(("GeomLoss in POT's tests", library, "pot_fixtures", root, files))
    if extra is not None:
        suites.append((f"{library}: a checkout", library, fixtures, extra, [extra]))
    return suites


def run(
    suite: tuple[str, str, str], device: str, root: Path, files: list[Path], report: Path,
    select: str, verbose: bool,
) -> list[outcomes.Outcome]:  # fmt: skip
    """Run test files in a process of their own, and return how each test ended."""
    library, adapter, fixtures = suite
    report.unlink(missing_ok=True)
    paths = [str(TOOLS), str(TOOLS.parent), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        "CLMORPH_PEER_LIBRARY": library,
        "CLMORPH_PEER_ADAPTER": adapter,
        "CLMORPH_PEER_FIXTURES": fixtures,
        "CLMORPH_PEER_REPORT": str(report),
        "CLMORPH_PEER_DEVICE": device,
        "JAX_PLATFORMS": "cpu",
    }
    # Of the library's own settings of pytest none is read, nor of ours.
    command = [
        sys.executable, "-m", "pytest", "-p", "peers.plugin", "-p", "no:cacheprovider", "-q",
        "-c", os.devnull, "--rootdir", str(root), "-W", "ignore", "--tb", "short",
        "-k", select, *map(str, files),
    ]  # fmt: skip
    if library == "geomloss":
        command[command.index("-k") + 1] = "geomloss"
    done = subprocess.run(
        command, cwd=report.parent, env=environment, check=False, text=True,
        stdout=None if verbose else subprocess.PIPE, stderr=subprocess.STDOUT,
    )  # fmt: skip
    found = outcomes.read(report)
    if done.returncode not in (0, 1, 5):
        last = (done.stdout or "see above").strip().splitlines()[-15:]
        found.append(outcomes.Outcome("pytest itself", "failed", "\n".join(last), 0))
    return found


if __name__ == "__main__":
    raise SystemExit(main())
