"""Sphinx configuration: `python -m sphinx -W -n -b html docs docs/_build`."""

import sys
from importlib.metadata import version as installed_version
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

project = "spherejax"
author = "the spherejax authors"
version = release = installed_version("spherejax")
project_copyright = author

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "docstrings",
    "signatures",
    "mathml",
    "result_tables",
    "scene_gallery",
    "floors",
    "run_files",
    "public_names",
    "notebooks",
]
exclude_patterns = ["_build", "extensions", "paper"]
source_suffix = {".md": "markdown"}
nitpicky = True
NOT_PUBLIC = "physics|motion|model|foundations|output"
PARTLY_PUBLIC = "compiler|studies|files"
"""Namespaces that hold private modules as well."""
nitpick_ignore_regex = [
    # The documentation of other packages is not there without a network.
    ("py:.*", r"(?!spherejax\.).*"),
    ("py:.*", rf"spherejax\.({NOT_PUBLIC})\..*"),
    ("py:.*", rf"spherejax\.({PARTLY_PUBLIC})\.[a-z_]+\..*"),
]
suppress_warnings = ["autosummary"]

myst_enable_extensions = [
    "dollarmath",
    "amsmath",
    "colon_fence",
    "deflist",
    "fieldlist",
]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_default_options = {"exclude-members": "__init__"}
maximum_signature_line_length = 88
python_use_unqualified_type_names = True
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "pydata_sphinx_theme"
html_title = "spherejax"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_favicon = "_static/mark.svg"
html_show_sourcelink = False
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "header_links_before_dropdown": 8,
    "show_toc_level": 1,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": True,
    "back_to_top_button": False,
}
html_context = {"default_mode": "auto"}
html_sidebars = {"index": [], "comparison": [], "gallery": [], "notebooks": []}
