"""Figures of the tutorials: each figure appears after the block that drew it.

The package draws without a window, so pyplot does not list its figures; they are found among the
variables of the script instead, each once.

Limitations: a script that gives a second figure the name of the first in the same block.
"""

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

DPI = 160
SHOWN = "_shown_in_gallery"  # attribute of a figure that was shown


def figures(block: Any, variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """Save the new figures of a block, and return the text that shows them."""
    paths = []
    for value in variables["example_globals"].values():
        if isinstance(value, Figure) and not hasattr(value, SHOWN):
            path = str(next(variables["image_path_iterator"]))
            value.savefig(path, dpi=DPI, metadata={"Software": None})
            setattr(value, SHOWN, True)
            paths.append(path)
    return str(figure_rst(paths, settings["src_dir"]))
