"""What a reproduction leaves behind: REPORT.md, the table as table.json, table.csv and table.md, each figure as PNG and SVG.

Everything is made in a folder of its own inside the one that was asked for and moved there at the end: whoever presses Ctrl-C
finds the files of one run there, never of two.
"""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hapticd.errors import ConfigError
from hapticd.measure.progress import Progress, Steps, silent
from hapticd.measure.reproduce_rows import Row
from hapticd.report import figures
from hapticd.report.paper_page import Section, page, table_part
from hapticd.report.paper_table import as_json

TITLE = "The paper, reproduced"
TABLE_JSON = "table.json"


def keep(sections: Sequence[Section], folder: Path, told: Mapping[str, Any], tell: Progress = silent) -> list[Path]:
    """Write it all into `folder`, which is made; `told` (quick, seeds, table, provenance) goes into table.json. ConfigError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".unfinished-", dir=folder) as name:
            unfinished = Path(name)
            _draw(sections, unfinished, tell)
            _write(sections, unfinished, told)
            return [file.replace(folder / file.name) for file in sorted(unfinished.iterdir())]
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}; name a folder that you may write to with --out") from error


def _draw(sections: Sequence[Section], folder: Path, tell: Progress) -> None:
    drawings = [drawing for section in sections for drawing in section.drawings]
    steps = Steps(tell, len(drawings))
    for drawing in drawings:
        steps.next(f"drawing {drawing.name}")
        with figures.style():
            figures.save(drawing.draw(), folder, drawing.name)
    steps.end()


def _write(sections: Sequence[Section], folder: Path, told: Mapping[str, Any]) -> None:
    rows = [row for section in sections for row in section.rows]
    (folder / TABLE_JSON).write_text(json.dumps(told, indent=1) + "\n")
    (folder / "table.md").write_text(table_part(Section(TITLE, "", tuple(rows))) + "\n")
    (folder / "REPORT.md").write_text(page(TITLE, _head(told), sections))
    with (folder / "table.csv").open("w", newline="") as file:
        _csv(rows, file)


def _csv(rows: Sequence[Row], file: Any) -> None:
    content = as_json(rows)
    writer = csv.DictWriter(file, list(content[0]))
    writer.writeheader()
    writer.writerows(content)


def _head(told: Mapping[str, Any]) -> str:
    how = (
        "by prediction alone, without trials"
        if told["quick"]
        else f"90 s trials, {told['seeds']} seeds behind each limit on its axis"
    )
    made = told["provenance"]
    versions = ", ".join(f"{name} {version}" for name, version in made["libraries"].items())
    return (
        "D. W. Weir, J. E. Colgate and M. A. Peshkin, *Measuring and increasing Z-width with active electrical damping*, Haptics "
        f"Symposium 2008, on SIMULATED devices: {how}. Made {made['date']} by hapticd {made['hapticd']} ({versions}). "
        "What was tried and what does not match is told in docs/reproduction.md."
    )
