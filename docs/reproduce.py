"""Update docs/reproduction.md with a run: `python docs/reproduce.py build/reproduction`, or `make
reproduction-docs`.

Its table.json and its figures are copied, the figures at half their resolution, which suits a
screen, and with fewer colours: an eighth of the bytes.

Numbers and tables of the page are filled in; the text is written by hand. After a change of the
text alone, docs/figures/reproduction is the run.
"""

import json
import shutil
import sys
from pathlib import Path

from pages.reproduction import filled

from examples.weir2008.table import from_json

DOCS = Path(__file__).parent
PAGE = DOCS / "reproduction.md"
FIGURES = DOCS / "figures" / "reproduction"
COLOURS = 128


def refresh(run: Path) -> None:
    """Update the page from a run folder of `python -m examples.weir2008`."""
    summary = json.loads((run / "table.json").read_text())
    if summary["quick"]:
        raise SystemExit(f"{run}: predicted with --quick; the page reports trials: run it without")
    PAGE.write_text(filled(PAGE.read_text(), from_json(summary["table"])))
    if run.resolve() != FIGURES.resolve():
        copy(run)


def copy(run: Path) -> None:
    """Copy its figures, and no others, and its table."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    for old in FIGURES.glob("*.png"):
        old.unlink()
    for figure in sorted(run.glob("*.png")):
        shrink(figure, FIGURES / figure.name)
    shutil.copy(run / "table.json", FIGURES / "table.json")


def shrink(figure: Path, to: Path) -> None:
    """Write a PNG of 150 dpi with at most COLOURS colours."""
    from PIL import Image  # installed with matplotlib

    half = Image.open(figure).convert("RGB").reduce(2)
    half.quantize(COLOURS, dither=Image.Dither.NONE).save(to, optimize=True)


if __name__ == "__main__":
    refresh(Path(sys.argv[1]))
