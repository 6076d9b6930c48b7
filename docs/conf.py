"""Sphinx configuration: Markdown pages by MyST, the API reference from docstrings, the furo theme."""

import gc
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))
sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))

import craftsim

# Most of what is read stays until the end: looking for garbage among it often is in vain.
gc.set_threshold(200_000)

project = "craftsim"
author = "The craftsim developers"
version = release = craftsim.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "generated", "player", "public_names"]
exclude_patterns = ["_build", "results/*"]

myst_enable_extensions = ["attrs_inline"]
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"
autodoc_preserve_defaults = True
python_use_unqualified_type_names = True
maximum_signature_line_length = 100

html_theme = "furo"
html_title = f"craftsim {version}"
html_copy_source = False
html_extra_path = ["llms.txt"]
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False
