"""The site: `make docs` builds it from this folder into build/site, notebooks executed, warnings as errors."""

import re
import sys
from importlib import metadata
from pathlib import Path

from docutils import nodes
from pygments.lexers.special import TextLexer
from sphinx.util import logging

sys.path.insert(0, str(Path(__file__).parent))
from links import broken_links

project = "linkplan"
author = "the linkplan authors"
project_copyright = "Apache-2.0"
release = version = metadata.version("linkplan")

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_argparse_cli",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",  # MathJax stands in the site: nothing is fetched from elsewhere
]
exclude_patterns = ["conf.py", "links.py", "tools/*", "notebooks/*.ipynb"]  # the site executes the notebooks' Python files

myst_enable_extensions = ["dollarmath", "amsmath"]
myst_heading_anchors = 3

# Notebooks are Python files in the percent format; they run where nothing of ours lies about.
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

default_role = "code"  # what stands in single backticks in docstrings
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False

html_theme = "furo"
html_title = f"linkplan {version}"
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072b2", "color-brand-content": "#0072b2"},
    "dark_css_variables": {"color-brand-primary": "#56b4e9", "color-brand-content": "#56b4e9"},
}
html_static_path = ["static"]
html_css_files = ["site.css"]


def mark_sentences(_app, doctree: nodes.document, _page: str) -> None:
    """Mark printed texts without columns as sentences, whose lines may be folded (static/site.css)."""
    for block in doctree.findall(nodes.literal_block):
        if block.get("language") == "text" and not re.search(r"\S {2,}\S", block.astext()):
            block["classes"].append("sentences")


def warn_of_broken_links(app, error: Exception | None) -> None:
    """Warn of every link of the finished site that leads nowhere, raw HTML and pictures of notebooks included."""
    for link in [] if error else broken_links(Path(app.outdir)):
        logging.getLogger(__name__).warning(link)


def setup(app) -> None:
    """Connect what this site does to its pages."""
    app.add_lexer("csv", TextLexer)
    app.connect("doctree-resolved", mark_sentences)
    app.connect("build-finished", warn_of_broken_links)
