"""Sphinx's settings for the site; `build.py` runs it."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import build  # noqa: E402

import clmorph  # noqa: E402

project, author = "clmorph", "The clmorph authors"
version = release = clmorph.__version__
copyright = "the clmorph authors"
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_parser",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
# The staged source holds links to pages alone, and what the gallery makes.
exclude_patterns = ["gallery/**/*.ipynb", "gallery/**/*.py"]
default_role = "py:obj"
root_doc = "index"
# The paths of the build and the search's index are the same each time.
html_last_updated_fmt = None

# Headings are targets of links, as on the pages' other home.
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
# What "text" and options of a shell are in blocks has no lexer that is right.
highlight_language = "python"

autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_typehints = "none"
templates_path = [str(HERE / "templates")]
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "pydata_sphinx_theme"
html_title = "clmorph"
html_static_path = [str(HERE / "static")]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
# Summaries of results are fetched, which a browser refuses for files.
html_show_search_summary = False
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 6,
    "navbar_end": ["theme-switcher"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc", "sg_download_links"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {"index": [], "clmorph-api": []}

linkcheck_timeout = 30
linkcheck_retries = 3
# Addresses of this machine, which the pages name as examples.
linkcheck_ignore = [r"http://(127\.0\.0\.1|localhost)"]

sphinx_gallery_conf = {
    "examples_dirs": str(HERE / "examples"),
    "gallery_dirs": "gallery",
    "filename_pattern": build.pattern(os.environ.get("CLMORPH_SITE_RUN", "all")),
    "ignore_pattern": r"__init__\.py",
    "subsection_order": "build.group_number",
    "within_subsection_order": "build.ExampleOrder",
    "capture_repr": ("_repr_html_",),
    "image_scrapers": ("matplotlib",),
    "remove_config_comments": True,
    "download_all_examples": False,
    "show_memory": False,
    "min_reported_time": 1e9,
    "show_signature": False,
    "write_computation_times": False,
    "plot_gallery": "True",
    "abort_on_example_error": False,
    "only_warn_on_example_error": False,
    "reset_modules": ("matplotlib",),
    "backreferences_dir": "gallery/uses",
    "doc_module": ("clmorph",),
    "image_srcset": ["2x"],
    "compress_images": (),
}


def _norms(_app, _what, _name, _object, _options, lines):
    """Let the bars of ``|x - y|`` in docstrings be bars; in reStructuredText they are marks."""
    for number, line in enumerate(lines):
        if not line.lstrip().startswith((">>>", "...")):
            parts = line.split("`")
            parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
            lines[number] = "`".join(parts)


def setup(app):
    """Connect what docstrings need."""
    app.connect("autodoc-process-docstring", _norms, priority=100)
