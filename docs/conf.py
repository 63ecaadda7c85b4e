"""The documentation site: `make docs` builds it with Sphinx, and warnings are errors."""

import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small dense solves are slower with more
sys.path.insert(0, str(Path(__file__).parent))

from docutils import nodes
from sphinx.application import Sphinx

import ohmskin

project = "ohmskin"
version = release = ohmskin.__version__
copyright = "the ohmskin authors, Apache-2.0"  # noqa: A001

extensions = [
    "myst_nb",  # Markdown and notebooks
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "reference_pages",  # docs/reference_pages.py
]
exclude_patterns = [
    "_build",
    *(f"gallery/*.{kind}" for kind in ("ipynb", "json", "md5", "py", "zip")),
    "**/.ipynb_checkpoints",
]
default_role = "py:class"  # a class in backticks is a link

html_theme = "furo"
html_title = f"ohmskin {version}"
html_favicon = "../src/ohmskin/view/static/icon.svg"
html_static_path, html_css_files = ["static"], ["site.css"]
html_show_sourcelink = html_copy_source = False

myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 300

autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_typehints = "none"
napoleon_numpy_docstring = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"/\d\d_",
    "within_subsection_order": "FileNameSortKey",
    "image_scrapers": "gallery_pictures.take",
    "reset_argv": "gallery_pictures.arguments",
    "reset_modules": "gallery_pictures.strict",
    "reset_modules_order": "both",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_signature": False,
    "write_computation_times": False,  # a page that loads scripts from elsewhere
    "remove_config_comments": True,
}


def mark_cells(_: Sphinx, page: nodes.document, __: str) -> None:
    """Tell site.css which cells of tables are sentences and which are short, as Markdown cannot."""
    for cell in page.findall(nodes.entry):
        cell["classes"].append("sentence" if len(cell.astext()) > 24 else "short")


def setup(app: Sphinx) -> None:
    """What Sphinx calls."""
    app.connect("doctree-resolved", mark_cells)
