"""The documentation site: `make docs`. generate.py writes the pages that repeat a table of the
program; the tutorials run during the build.
"""

import sys
from pathlib import Path
from typing import Any

import hapticd

sys.path.insert(0, str(Path(__file__).parent))

from pages.contents import contents
from pages.docstrings import as_text, named

project = "hapticd"
author = "hapticd contributors"
copyright = "hapticd contributors, BSD-3-Clause"
version = release = hapticd.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx_gallery.gen_gallery"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
smartquotes = False  # `--json` is typed with two hyphens, and quotes are copied
highlight_language = "console"
exclude_patterns = ["adr/0000-template.md", "faults/*", "tutorials/*"]
html_theme = "furo"
html_title = f"hapticd {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["tables.js"]
autodoc_member_order = "bysource"
python_maximum_signature_line_length = 100
sphinx_gallery_conf = {
    "examples_dirs": "tutorials",
    "gallery_dirs": "generated/tutorials",
    "filename_pattern": r"/t\d_",
    "image_scrapers": ("pages.gallery.figures",),
    "within_subsection_order": "FileNameSortKey",
    "capture_repr": (),
    "run_stale_examples": True,  # also if only the package has changed
    "abort_on_example_error": True,
    "min_reported_time": 1e6,
    "write_computation_times": False,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
}


def setup(app: Any) -> None:
    """Connect the converters: docstrings are plain text, and the first page lists the others."""
    app.connect("source-read", contents)
    app.connect("autodoc-process-docstring", as_text)
    app.connect("autodoc-process-signature", named)
