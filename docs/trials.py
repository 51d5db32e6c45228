"""Fill the tables of docs/trials.md: the score of hapticd's own verdicts on the trials.

    python -m examples.trials make --out build/trials
    python -m examples.trials make --out build/trials-90 --seconds 90
    python docs/trials.py build/trials build/trials-90

The first folder fills the tables of the standard data, the second that of longer records.
"""

import json
import sys
from collections import Counter
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent)]

from pages.markdown import replaced, table  # noqa: E402

from examples.trials.files import TRUTH  # noqa: E402
from examples.trials.judge import judge  # noqa: E402
from examples.trials.score import (  # noqa: E402
    HEADINGS,
    OUTCOMES,
    Judgement,
    read_truth,
    score,
    score_table,
)
from hapticd.zwidth.report.paper import shown  # noqa: E402

PAGE = DOCS / "trials.md"
PLACES = ("score", "score of 90 s")


def judged(folder: Path) -> list[Judgement]:
    """Return our verdicts on a folder with its truth."""
    return score(judge(folder), read_truth(folder / TRUTH))


def by_group(found: list[Judgement]) -> str:
    """Return a line for each kind of trial."""
    rows = [tuple(shown(cell) for cell in row) for row in score_table(found).rows]
    return table(HEADINGS, rows)


def by_device(folder: Path, found: list[Judgement]) -> str:
    """Return a line for each device, which only the truth contains."""
    kept = json.loads((folder / TRUTH).read_text())["trials"]
    counts: dict[str, Counter[str]] = {}
    for one in found:
        counts.setdefault(kept[one.given.trial]["device"], Counter())[one.outcome] += 1
    rows = [
        (device, *(str(count[outcome]) for outcome in OUTCOMES))
        for device, count in sorted(counts.items())
    ]
    return table(("device", *(outcome.replace("_", " ") for outcome in OUTCOMES)), rows)


def main(folders: list[Path]) -> None:
    """Judge the folders and fill the page."""
    page = PAGE.read_text()
    for folder, place in zip(folders, PLACES, strict=True):
        found = judged(folder)
        page = replaced(page, place, by_group(found))
        page = replaced(page, f"{place} by device", by_device(folder, found))
    PAGE.write_text(page)


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
