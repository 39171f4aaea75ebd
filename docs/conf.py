"""The documentation site: ``nox -s docs`` builds it.

The root of the sources is the repository's, not this folder: the pages are those that people read
in a checkout (README.md, recipes/README.md, ...), and a link means the same here and there.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(Path(__file__).with_name("_ext")))

import pemirl_trl  # noqa: E402  # after the path; it is installed

project = "pemirl-trl"
author = "The pemirl-trl authors"
release = version = pemirl_trl.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "myst_nb",
    "mathml",
    "reference",
    "repository",
]
root_doc = "docs/index"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "data/README.md",
    "docs/**.md",
    "docs/**.rst",
    "recipes/README.md",
    "zoo/*.md",
]
exclude_patterns = [".*", "build", "dist", "outputs", "multirun", "runs", "results", "src", "envs"]
suppress_warnings = ["misc.highlighting_failure"]  # shown are messages and pseudocode, too

# Equations and notebooks: an error in one fails the build.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
html_math_renderer = "mathml"
nb_execution_mode = "force"
nb_execution_raise_on_error = False  # a warning with its traceback, which -W makes an error
nb_execution_timeout = 300  # seconds, of one cell
nb_execution_show_tb = True
nb_output_stderr = "remove"  # what libraries warn of at import

# The reference: what ``__all__`` says, each name once, with its signature and types.
autodoc_inherit_docstrings = False  # torch's texts are torch's
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
python_maximum_signature_line_length = 88
add_module_names = False

html_theme = "furo"
html_title = f"pemirl-trl {release}"
html_additional_pages = {"index": "redirect.html"}
html_copy_source = False
html_static_path = ["_static"]
html_css_files = ["math.css"]
html_show_copyright = False
templates_path = ["_templates"]
