"""Settings of the documentation site; `make docs` builds it into build/docs."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_ext"))

project = "rigtool"
author = "rigtool developers"
version = release = version_of("rigtool")
extensions = ["myst_parser", "generated", "mathml"]
exclude_patterns = ["_ext", "_static"]
source_suffix = {".md": "markdown"}

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3

smartquotes = False  # two hyphens begin an option

html_theme = "furo"
html_title = f"rigtool {version}"
html_math_renderer = "mathml"
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
templates_path: list[str] = []
suppress_warnings = ["myst.strikethrough"]
