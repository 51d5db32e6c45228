"""Strips below an envelope: which part of the owner's |Z| weighs most at each frequency, K/w, |B| or |M| w, and its sign."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hapticd.analysis.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NOBODY = -1.0

Part = tuple[str, str]  # name and colour

NOTHING: Part = ("nobody", "#ffffff")


def weightiest(frequency_hz: Floats, owners: Floats) -> Floats:
    """(F,) 0 K, 1 B > 0, 2 M > 0, 3 B < 0, 4 M < 0, NOBODY where nothing is rendered; for owners (K, B, M) (F, 3)."""
    w = 2.0 * np.pi * frequency_hz
    parts = np.stack((owners[:, 0] / w, owners[:, 1], owners[:, 2] * w))
    which = np.abs(parts).argmax(axis=0)
    below = np.take_along_axis(parts, which[None], 0)[0] < 0.0
    return np.where(parts.any(axis=0), which + 2.0 * below, NOBODY)


def strip(axis: "Axes", frequency_hz: Floats, rows: Sequence[Floats], parts: Sequence[Part], nothing: Part) -> Floats:
    """Paint rows (F,) of indices into `parts`, NOBODY for `nothing`, from below; the borders (F + 1,) between frequencies."""
    from matplotlib.colors import ListedColormap

    middle = np.sqrt(frequency_hz[1:] * frequency_hz[:-1])
    borders = np.concatenate((frequency_hz[:1], middle, frequency_hz[-1:]))
    colours = ListedColormap([colour for _, colour in (nothing, *parts)])
    heights = np.arange(len(rows) + 1.0)
    axis.pcolormesh(borders, heights, np.array(rows), cmap=colours, vmin=-1.5, vmax=len(parts) - 0.5, rasterized=True)
    axis.grid(visible=False)
    axis.tick_params(length=0)
    return borders


def patches(parts: Sequence[Part], nothing: Part) -> list[Any]:
    """Handles of a legend."""
    from matplotlib.patches import Patch

    return [Patch(facecolor=colour, edgecolor="#bbbbbb", linewidth=0.6, label=name) for name, colour in (*parts, nothing)]
