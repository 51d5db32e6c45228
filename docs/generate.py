"""Write the reference pages below docs/generated, the drawing of the layers, and the tables of
docs/analysis.md: `python docs/generate.py`, before each build of the site.
"""

from pathlib import Path

from pages.commands import commands_page
from pages.faults import fault_page, faults_page
from pages.layers import DRAWING, drawing
from pages.markdown import replaced
from pages.messages import messages_page
from pages.records import bits_tables, fields_table
from pages.scenes import effects_page, scene_page
from pages.settings import settings_page
from pages.simulated_board import simulated_board_page

from hapticd.core.faults import FAULTS

GENERATED = Path(__file__).parent / "generated"
ANALYSIS = Path(__file__).parent / "analysis.md"


def pages() -> dict[str, str]:
    """Return all generated pages by path."""
    return {
        "configuration.md": settings_page("config", "Configuration"),
        "device.md": settings_page("device", "Device file"),
        "commands.md": commands_page(),
        "scene.md": scene_page(),
        "effects.md": effects_page(),
        "messages.md": messages_page(),
        "simulated-board.md": simulated_board_page(),
        "faults/index.md": faults_page(),
        **{f"faults/{fault.code}.md": fault_page(fault) for fault in FAULTS[1:]},
    }


def write_pages(folder: Path) -> None:
    """Write changed pages, and remove obsolete ones."""
    wanted = pages()
    for path in folder.rglob("*.md"):
        if str(path.relative_to(folder)) not in wanted:
            path.unlink()
    for name, text in wanted.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text() != text:
            path.write_text(text)


def analysis_page(text: str) -> str:
    """Return the page on recordings, with the program's tables of fields and of bits."""
    return replaced(replaced(text, "fields", fields_table()), "bits", bits_tables())


if __name__ == "__main__":
    write_pages(GENERATED)
    DRAWING.write_text(drawing())
    ANALYSIS.write_text(analysis_page(ANALYSIS.read_text()))
