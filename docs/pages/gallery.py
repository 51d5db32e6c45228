"""Figures of the tutorials: what a script draws is shown where it was drawn.

The package draws without a window, so its figures are not among those that pyplot knows; they are
found among the names of the script instead, each once.

What would break it: a script that gives a second figure the name of the first in one and the same
block.
"""

from typing import Any

from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst

DPI = 160
SHOWN = "_shown_in_gallery"  # attribute of a figure that was


def figures(block: Any, variables: dict[str, Any], settings: dict[str, Any]) -> str:
    """The new figures of a block as files, and the text that shows them."""
    paths = []
    for value in variables["example_globals"].values():
        if isinstance(value, Figure) and not hasattr(value, SHOWN):
            path = str(next(variables["image_path_iterator"]))
            value.savefig(path, dpi=DPI, metadata={"Software": None})
            setattr(value, SHOWN, True)
            paths.append(path)
    return str(figure_rst(paths, settings["src_dir"]))
