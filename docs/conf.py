"""The documentation site: `make docs`. Pages that repeat a table of the program are made by
generate.py before.
"""

import hapticd

project = "hapticd"
author = "hapticd contributors"
copyright = "hapticd contributors, BSD-3-Clause"
version = release = hapticd.__version__
extensions = ["myst_parser"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
exclude_patterns = ["adr/0000-template.md", "faults/*"]
html_theme = "furo"
html_title = f"hapticd {release}"
