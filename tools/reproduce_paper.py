"""Make the paper's tables and figures for any two images, and one page that shows them.

    pip install -e ".[cpu,paper]"
    python tools/reproduce_paper.py --out reproduction
    python tools/reproduce_paper.py --source a.png --target b.jpg --out reproduction

Without images it takes the bundled sprite and scikit-image's photograph of a cat. Whether two
images are the authors' pair shows in Table 1, and the page says it. Everything is written as PNG
and CSV, and into ``report.html``, one file that needs no network; what each table and figure says
is printed too. Exit codes: 0 done; 2 a mistake in the command line, a file or the choice of
device, told in one line; 130 interrupted.
"""

import argparse
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import NoReturn

import clmorph
from clmorph.cli.terminal import NOTES, Stages
from clmorph.errors import ClmorphError, InputError, OutputError

NAME = "reproduce_paper"
#: Pixels of ``--quick``, and the paper's.
QUICK_SIZE, SIZE = 20, 48
#: Whole plans are kept for Table 1: 3 GB at this size.
LARGEST = 128


class Parser(argparse.ArgumentParser):
    """Tells mistakes in one line, as the command ``clmorph`` does."""

    def error(self, message: str) -> NoReturn:
        """Raise what `main` prints."""
        raise InputError(f"{message} ({self.prog} --help shows the usage)")


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = Parser(prog=NAME, description=__doc__.splitlines()[0])
    parser.add_argument("--source", type=Path, help="an image; the bundled sprite if none")
    parser.add_argument("--target", type=Path, help="an image; scikit-image's chelsea if none")
    parser.add_argument("--out", type=Path, required=True, help="a new or empty folder")
    parser.add_argument("--size", type=int, help=f"side, in pixels ({SIZE}; quick: {QUICK_SIZE})")
    parser.add_argument("--device", default="auto", help="as for clmorph.get_backend")
    parser.add_argument("--quick", action="store_true", help="small, and fewer points")
    parser.add_argument("--geomloss", action="store_true", help="run GeomLoss itself beside")
    parser.add_argument("--published", action="store_true", help="print the paper's numbers too")
    options = parser.parse_args(arguments)
    if (options.source is None) != (options.target is None):
        parser.error("give both --source and --target, or neither")
    if options.size is None:
        options.size = QUICK_SIZE if options.quick else SIZE
    if not 8 <= options.size <= LARGEST:
        parser.error(f"--size {options.size}: expected 8 to {LARGEST}")
    return options


def reproduce(options: argparse.Namespace, folder: Path, stages: Stages) -> list[str]:
    """Write every file into a folder; return what they say, a line each."""
    try:
        from paper import fields, timelines
        from paper.convergence import convergence
        from paper.debiasing import debiasing
        from paper.drawing import ENLARGED, pyplot
        from paper.geomloss import check_installed
        from paper.grids import figure_3
        from paper.pair import load_pair
        from paper.pruned import pruned
        from paper.readings import readings
        from paper.report import write_csv, write_report
        from paper.setting import Setting
        from paper.table1 import recognized, table_1
        from paper.threshold import threshold
        from paper.width_figures import table_2_and_figures_7_and_8
    except ModuleNotFoundError as error:
        if error.name != "matplotlib":
            raise
        raise InputError(
            "matplotlib is not installed; pip install -e '.[paper]' brings it"
        ) from None

    if options.geomloss:
        check_installed()
    pair = load_pair(options.source, options.target)
    operations = clmorph.get_backend(options.device)
    setting = Setting(
        pair, options.size, options.quick, operations, folder, options.geomloss,
        options.published, stages,
    )  # fmt: skip
    began = time.perf_counter()
    sections = []
    for make in (
        table_1, table_2_and_figures_7_and_8, timelines.figure_1, fields.figures_2_and_6,
        figure_3, timelines.figure_4, timelines.figure_5, pruned, debiasing, readings, threshold,
        fields.mass_images, convergence,
    ):  # fmt: skip
        sections += make(setting)
    order = {"table": 0, "figure": 1}
    sections.sort(key=lambda section: (order.get(section.name.split("-")[0], 2), section.title))
    for section in sections:
        write_csv(section, folder)
    used = []
    for name, image in zip(("source", "target"), pair.fitted(options.size), strict=True):
        path = folder / f"{name}.png"
        factor = max(1, ENLARGED // max(image.shape[:2]))
        pyplot.imsave(path, image.repeat(factor, 0).repeat(factor, 1),
                      metadata={"Software": None})  # fmt: skip
        used.append((path, f"{name}: {pair.names[name == 'target']}"))
    seconds = time.perf_counter() - began
    own = recognized(setting).text
    device = setting.operations.description
    write_report(folder, sections, used, _facts(options, own, device, seconds))
    return [own, *(f"{section.name}: {section.says}" for section in sections)]


def _facts(options: argparse.Namespace, own: str, device: str, seconds: float) -> str:
    quick = " This is a quick run: small images and few points." if options.quick else ""
    return (
        f'<p class="small">{escape(own + quick)}</p><p class="small">clmorph '
        f"{escape(clmorph.__version__)} on {escape(device)}, {options.size} pixels a side, "
        f"{seconds:.0f} s.</p>"
    )


def check_folder(out: Path) -> Path:
    """Return the folder beside which the result is made.

    Raises
    ------
    OutputError
        If it cannot be.
    """
    if out.exists() and not (out.is_dir() and not any(out.iterdir())):
        raise OutputError(f"--out {out} exists already: choose a new or empty folder")
    parent = out.resolve().parent
    if not parent.is_dir():
        raise OutputError(f"--out {out}: there is no folder {parent}; make it first")
    return parent


def run(options: argparse.Namespace) -> list[str]:
    """Make everything beside its place and move it there whole: never a half-written folder.

    Returns
    -------
    list of str
        What the tables and figures say.
    """
    parent = check_folder(options.out)
    temporary = None
    try:
        temporary = Path(tempfile.mkdtemp(dir=parent, prefix=".reproduction-"))
        made = temporary / "made"
        made.mkdir()
        with warnings.catch_warnings(record=True) as caught, Stages() as stages:
            warnings.simplefilter("always", clmorph.ConvergenceWarning)
            warnings.simplefilter("always", clmorph.ImageWarning)
            says = reproduce(options, made, stages)
        for note in dict.fromkeys(str(warning.message) for warning in caught):
            NOTES.print(f"{NAME}: note: {note}", markup=False)
        if options.out.exists():
            options.out.rmdir()
        made.replace(options.out)
        return says
    except OSError as error:
        raise OutputError(
            f"--out {options.out} cannot be written ({error.strerror or error})"
        ) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    try:
        options = parse(arguments)
        says = run(options)
    except ClmorphError as error:
        print(f"{NAME}: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except MemoryError:
        print(f"{NAME}: error: not enough memory; use a smaller --size", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{NAME}: interrupted, nothing was written", file=sys.stderr)
        return 130
    for line in says:
        print(line)
    print(f"wrote {options.out / 'report.html'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
