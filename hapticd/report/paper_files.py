"""What a reproduction leaves behind: REPORT.md, the table as table.json, table.csv and table.md, each figure as PNG and SVG.

Everything is made in a folder of its own inside the one that was asked for and moved there at the end, where it takes the place
of the run before: whoever presses Ctrl-C finds the files of one run there, and so does whoever asks for a run that makes less.
What the run before made, its report names; files that it does not name are somebody else's and stay.
"""

import csv
import json
import re
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
TABLE_JSON, REPORT = "table.json", "REPORT.md"


def keep(sections: Sequence[Section], folder: Path, told: Mapping[str, Any], tell: Progress = silent) -> list[Path]:
    """Write it all into `folder`, which is made; `told` (quick, seeds, table, provenance) goes into table.json. ConfigError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(prefix=".unfinished-", dir=folder) as name:
            unfinished = Path(name)
            _draw(sections, unfinished, tell)
            _write(sections, unfinished, told)
            made = sorted(unfinished.iterdir())
            for name in _of_the_run_before(folder) - {file.name for file in made}:
                (folder / name).unlink(missing_ok=True)
            return [file.replace(folder / file.name) for file in made]
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror}; name a folder that you may write to with --out") from error


def _of_the_run_before(folder: Path) -> set[str]:
    """Names of its figures."""
    if not (folder / REPORT).is_file():
        return set()
    named = re.findall(r"\]\((\w+)\.png\)", (folder / REPORT).read_text(errors="replace"))
    return {f"{name}.{kind}" for name in named for kind in ("png", "svg")}


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
    (folder / REPORT).write_text(page(TITLE, _head(told), sections))
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
