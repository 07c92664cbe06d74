"""Build the site: ``python tools/site/build.py OUT`` writes ``OUT/html/index.html``.

Warnings are errors, and every link within the site is followed. Results of examples are kept in
OUT, and an example runs again when it has changed. ``--run share`` runs some of the examples in a
minute or two; others are shown with the pictures that OUT has of them, or without. ``--renew``
forgets what OUT has. ``--external`` follows links to other sites, too, and needs a network.
"""

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urlsplit

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
#: The groups of examples, in their order.
GROUPS = ("films", "understanding", "transport", "peers", "devices", "lesson")
#: What a share of the examples is: quick ones of each group, without libraries that are large.
SHARE = ("films/sprites", "films/photographs", "understanding/plan_rows", "transport/unbalanced",
         "transport/gradient", "transport/batch", "transport/volume", "transport/field",
         "transport/cells", "devices/cross_check", "peers/pot")  # fmt: skip
#: Pages of the repository that are pages of the site.
PAGES = ("README.md", "CHANGELOG.md", ".github/*.md", "clmorph/**/README.md", "tools/README.md",
         "tests/README.md")  # fmt: skip
#: Public names of interfaces of other libraries.
INTERFACES = ("torch.sinkhorn_divergence", "jax.sinkhorn_divergence", "geomloss.SamplesLoss",
              "pot.solve_sample")  # fmt: skip
SECTIONS = {
    "Films and pictures": (
        "morph", "Morph", "MorphOptions", "load_options", "morph_clip", "rearrange",
        "Rearrangement", "RearrangeOptions", "recolor", "Recolored", "RecolorOptions",
        "recolor_clip", "Lut", "fit_lut", "apply_lut", "read_lut", "write_lut", "mix", "Mixes",
        "save", "load", "Archive", "read_image", "read_labels", "write_image", "fit", "inspect",
        "Inspection", "particles", "Particles", "density_path", "DensityPath",
    ),
    "Transport": (
        "lift", "density", "Measure", "WeightedPoints", "sinkhorn", "Potentials", "transport_plan",
        "Plan", "sample_plan", "barycentric_plan", "Barycentric", "displacement_statistics",
        "Displacement", "sinkhorn_divergence", "Divergence", "gradient", "Gradient", "barycenter",
        "Barycenter", "hessian_product", "assignment", "Assignment", "grid_measure", "Grid",
        "displacement_field", "DisplacementField",
    ),
    "Many problems": (
        "sinkhorn_batch", "PotentialsBatch", "sinkhorn_divergence_batch", "divergence_matrix",
        "DivergenceMatrix",
    ),
    "Devices": ("get_backend",),
}  # fmt: skip


def examples() -> dict[str, Path]:
    """Return the examples by group and name."""
    files = sorted((HERE / "examples").glob("*/*.py"))
    return {f"{file.parent.name}/{file.stem}": file for file in files}


def missing(file: Path) -> list[str]:
    """Return what an example imports and is not installed."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            names |= {each.name.partition(".")[0] for each in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names.add(node.module.partition(".")[0])
    return sorted(name for name in names if find_spec(name) is None)


def chosen(run: str) -> list[str]:
    """Return the examples that "all", "share" or "none" means."""
    return {"all": [*examples()], "share": [*SHARE], "none": []}[run]


def pattern(run: str) -> str:
    """Return the pattern of the paths of the examples that run."""
    paths = [re.escape(f"{os.sep}{name.replace('/', os.sep)}.py") for name in chosen(run)]
    return "|".join(paths) or r"(?!)"


class ExampleOrder:
    """The order of a group's examples: the one that a newcomer needs comes first."""

    FIRST = ("photographs.py", "what_moves.py", "point_clouds.py", "pot.py", "choice.py")

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __call__(self, name: str) -> tuple[bool, str]:
        """Return what the examples are sorted by."""
        return name not in self.FIRST, name


def group_number(folder: str) -> int:
    """Return the place of a folder of examples among the others."""
    return GROUPS.index(Path(folder).name)


def stage(source: Path) -> None:
    """Fill the folder that Sphinx reads with the pages at their own places, and what they show."""
    wanted = {HERE / f"{page}.md": source / f"{page}.md" for page in ("index", "pages")}
    pages = [file for each in PAGES for file in sorted(ROOT.glob(each))]
    for page in (*pages, HERE / "tasks.md"):
        # Publishers of pages leave out folders whose names begin with a dot.
        wanted[page] = source / str(page.relative_to(ROOT)).removeprefix(".")
        for target in re.findall(r"\]\(([^)\s#]+)[^)\s]*\)", page.read_text("utf-8")):
            file = (page.parent / target).resolve()
            if "://" not in target and file.is_file() and file.suffix != ".md":
                wanted[file] = source / file.relative_to(ROOT)
    wanted[ROOT / "tools/pictures/demo.png"] = source / "tools/pictures/demo.png"
    for file, place in wanted.items():
        place.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".md":
            place.write_text(file.read_text("utf-8").replace("](.github/", "](github/"), "utf-8")
        else:
            shutil.copyfile(file, place)
    (source / "clmorph-api.rst").write_text(reference(), "utf-8")
    kept = {*wanted.values(), source / "clmorph-api.rst"}
    for place in source.rglob("*"):
        made = place.relative_to(source).parts[0] in ("gallery", "api")
        if place.is_file() and not made and place not in kept:
            place.unlink()


def reference() -> str:
    """Return the page that lists every public name."""
    import clmorph

    public = {name for name in clmorph.__all__ if not name.startswith("_")}
    public -= {name for name in public if isinstance(getattr(clmorph, name), ModuleType)}
    sections = dict(SECTIONS)
    sections["Errors and warnings"] = tuple(
        sorted(name for name in public if name.endswith(("Error", "Warning")))
    )
    listed = {name for names in sections.values() for name in names}
    if listed != public:
        raise SystemExit(f"SECTIONS and the public names differ: {sorted(listed ^ public)}")
    lines = ["Reference", "=========", "", ".. currentmodule:: clmorph", ""]
    for title, names in sections.items():
        lines += table(title, names)
    lines += table(
        "The paper in plain NumPy", [f"reference.{n}" for n in clmorph.reference.__all__]
    )
    lines += table("Interfaces of other libraries", INTERFACES)
    return "\n".join(lines) + "\n"


def table(title: str, names: list[str] | tuple[str, ...]) -> list[str]:
    """Return a section with a table of names."""
    return [title, "-" * len(title), "", *summary(names)]


def summary(names: list[str] | tuple[str, ...]) -> list[str]:
    """Return a table of names, each with a page."""
    return [
        ".. autosummary::",
        "   :toctree: api",
        "   :nosignatures:",
        "",
        *(f"   {name}" for name in names),
        "",
    ]


class Page(HTMLParser):
    """What a page links to, and what can be linked to in it."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.names: set[str] = set()
        self.feed(file.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Remember links and names."""
        known = dict(attrs)
        self.links += [value for key in ("href", "src") if (value := known.get(key))]
        self.names |= {value for key in ("id", "name") if (value := known.get(key))}


def broken_links(html: Path) -> list[str]:
    """Return the links within a site that lead nowhere."""
    files = sorted(set(html.rglob("*.html")) - set(html.glob("_static/**/*.html")))
    pages = {file: Page(file) for file in files}
    found = []
    for file, page in pages.items():
        for target in dict.fromkeys(page.links):
            parts = urlsplit(target)
            if parts.scheme or parts.netloc or target in ("#", ""):
                continue
            place = (file.parent / unquote(parts.path)).resolve() if parts.path else file
            name = unquote(parts.fragment)
            if not place.is_file():
                found.append(f"{file.relative_to(html)}: no file {target}")
            elif name and place in pages and name not in pages[place].names:
                found.append(f"{file.relative_to(html)}: no place {target}")
    return found


def sphinx(builder: str, out: Path, run: str) -> None:
    """Run Sphinx, whose warnings are errors."""
    command = [
        sys.executable, "-m", "sphinx", "--builder", builder, "--conf-dir", HERE, "--doctree-dir",
        out / "doctrees", "--fail-on-warning", "--keep-going", "--quiet", out / "source",
        out / builder,
    ]  # fmt: skip
    environment = {**os.environ, "CLMORPH_SITE_RUN": run, "PYTHONHASHSEED": "0"}
    status = subprocess.run(command, env=environment, check=False).returncode
    if status:
        # What stands there now would not warn again.
        shutil.rmtree(out / "doctrees", ignore_errors=True)
        raise SystemExit(f"the site was not built: {builder} ended with {status}, see above")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="a folder outside of the repository")
    parser.add_argument("--run", choices=["all", "share", "none"], default="all")
    parser.add_argument("--renew", action="store_true", help="run examples again that have results")
    parser.add_argument("--external", action="store_true", help="follow links to other sites")
    options = parser.parse_args()
    out = options.out.resolve()
    if out.is_relative_to(ROOT):
        parser.error(f"{out}: expected a folder outside of the repository {ROOT}")
    absent = {name: missing(examples()[name]) for name in chosen(options.run)}
    absent = {name: modules for name, modules in absent.items() if modules}
    if absent:
        needed = sorted({module for modules in absent.values() for module in modules})
        parser.error(
            f"examples need {', '.join(needed)}: install the extras site and bench, or build with "
            "--run share"
        )
    if options.renew:
        shutil.rmtree(out / "source", ignore_errors=True)
    (out / "source").mkdir(parents=True, exist_ok=True)
    stage(out / "source")
    sphinx("html", out, options.run)
    broken = broken_links(out / "html")
    if broken:
        raise SystemExit("\n".join(broken))
    if options.external:
        sphinx("linkcheck", out, options.run)
    print(f"wrote {out / 'html' / 'index.html'}")


if __name__ == "__main__":
    main()
