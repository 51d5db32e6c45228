"""The drawing of the layers in docs/architecture.md, made from the imports of the code.

    packages  the direct children of `hapticd`, in the layers of the contract "layers" of
              pyproject.toml
    imports   A imports B if a module of A imports one of B; imports implied by a longer path are
              left out (the transitive reduction of a graph without cycles)

`python docs/generate.py` writes docs/figures/layers.svg; a test compares it with the code.

Limitations: packages that import each other, which the contract forbids.
"""

import tomllib
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[2]
DRAWING = ROOT / "docs" / "figures" / "layers.svg"
NO_PACKAGE = {"__main__", "_data"}  # the entry point, and the shipped files
WIDTH = 860  # of the sheet; all in pixels
HEIGHT = 46  # of a layer
GAP = 10  # between two boxes of a layer, and two layers
MARGIN = 14
HEAD = """<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" \
viewBox="0 0 {width} {height}" font-family="sans-serif">
<title>Packages of hapticd in layers, with what each of them imports</title>
<rect width="100%" height="100%" fill="#ffffff"/>"""
BOX = """<rect x="{left:g}" y="{top:g}" width="{width:g}" height="{height}" rx="5" \
fill="#eef4fa" stroke="#0072b2"/>
<text x="{middle:g}" y="{name_y:g}" text-anchor="middle" font-size="15" font-weight="bold" \
fill="#000000">{name}</text>
<text x="{middle:g}" y="{below_y:g}" text-anchor="middle" font-size="11" \
fill="#444444">{below}</text>"""


def layers() -> list[list[str]]:
    """Return the packages of each layer, the highest first, from the contract of import-linter."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    rows = next(one["layers"] for one in project["contracts"] if one["type"] == "layers")
    named = ([name.strip(" ()") for name in row.split("|")] for row in rows)
    present = [[name for name in row if name in imports()] for row in named]
    return [row for row in present if row]


@cache
def imports() -> dict[str, frozenset[str]]:
    """Return the packages that the modules of each package import."""
    graph = grimp.build_graph("hapticd")
    found = {}
    for package in graph.find_children("hapticd"):
        modules = {package, *graph.find_descendants(package)}
        used = {
            other.split(".")[1]
            for module in modules
            for other in graph.find_modules_directly_imported_by(module)
            if other.startswith("hapticd.")
        }
        name = package.split(".")[1]
        found[name] = frozenset(used - {name})
    return {name: used for name, used in found.items() if name not in NO_PACKAGE}


@cache
def below(name: str) -> frozenset[str]:
    """Return all packages reachable from one."""
    return imports()[name].union(*(below(other) for other in imports()[name]))


def nearest(name: str) -> list[str]:
    """Return the imports of a package, without those reachable through another one."""
    own = imports()[name]
    order = [other for row in layers() for other in row]
    return [
        other for other in order if other in own and not any(other in below(third) for third in own)
    ]


def drawing() -> str:
    """Return the layers as the text of an SVG file: the highest on top, a box for each package."""
    rows = layers()
    height = 2 * MARGIN + len(rows) * (HEIGHT + GAP) - GAP
    boxes = [box for depth, row in enumerate(rows) for box in _boxes(depth, row)]
    return "\n".join((HEAD.format(width=WIDTH, height=height), *boxes, "</svg>", ""))


def _boxes(depth: int, row: list[str]) -> list[str]:
    """Return a layer: its packages share the width of the sheet."""
    top = MARGIN + depth * (HEIGHT + GAP)
    width = (WIDTH - 2 * MARGIN - (len(row) - 1) * GAP) / len(row)
    found = []
    for number, name in enumerate(row):
        left = MARGIN + number * (width + GAP)
        used = ", ".join(nearest(name))
        found.append(
            BOX.format(
                left=left,
                top=top,
                width=width,
                height=HEIGHT,
                middle=left + width / 2,
                name=name,
                name_y=top + 20,
                below=f"imports {used}" if used else "imports no other package of hapticd",
                below_y=top + 37,
            )
        )
    return found
