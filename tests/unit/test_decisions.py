"""Decision records: each citation leads to a record, the index lists all of them, and the table of
former numbers is complete.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.tree import ROOT

ADR = ROOT / "docs" / "adr"
INDEX = (ADR / "index.md").read_text(encoding="utf-8")
HISTORY = ROOT / "docs" / "development" / "history.md"
RECORDS = sorted(path for path in ADR.glob("0*.md") if not path.name.startswith("0000"))
PARTS = ("Context", "Decision", "Consequences", "Rejected", "We would reverse it if")
FORMER = 136  # records that these were made of

FOLDERS = (
    "benchmarks", "config", "docs", "examples", "firmware_iface", "hapticd", "systemd", "tests",
)  # fmt: skip
ENDINGS = {
    ".c", ".cff", ".cir", ".css", ".h", ".html", ".js", ".json", ".md", ".mjs", ".py", ".rules",
    ".service", ".target", ".toml",
}  # fmt: skip
GENERATED = {"__pycache__", "generated", "node_modules"}


def texts() -> Iterator[Path]:
    """The files of the checkout that may cite a record."""
    paths = [path for path in ROOT.iterdir() if path.suffix in ENDINGS or path.name == "Makefile"]
    for folder in FOLDERS:
        paths += (ROOT / folder).rglob("*")
    return (
        path
        for path in sorted(paths)
        if path.suffix in ENDINGS | {""} and path.is_file() and not GENERATED & set(path.parts)
    )


def wrong_citations(text: str) -> list[str]:
    """Citations of no record, and those in the form that was used with the former numbers."""
    numbers = {path.name[:4] for path in RECORDS}
    cited = re.findall(r"\bADR-(\d+)", text)
    former = re.findall(r"\bADRs?\s\[?\d{4}|\badr/\d{4}(?!-)", text)
    return former + [f"ADR-{one}" for one in cited if one not in numbers]


def test_every_cited_record_exists() -> None:
    found = {
        str(path.relative_to(ROOT)): wrong
        for path in texts()
        if path != Path(__file__)
        and (wrong := wrong_citations(path.read_text(encoding="utf-8", errors="replace")))
    }
    assert found == {}


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("see ADR-0010 and docs/adr/0010-stop.md", []),
        ("see ADR-9999", ["ADR-9999"]),
        ("see ADR 0083, 0145", ["ADR 0083"]),
        ("Design notes: ADR\n[0083](x.md)", ["ADR\n[0083"]),
        ("(docs/adr/0035)", ["adr/0035"]),
    ],
)
def test_a_citation_of_no_record_is_found(text: str, wrong: list[str]) -> None:
    assert wrong_citations(text) == wrong


def test_records_are_numbered_without_gaps() -> None:
    assert [path.name[:4] for path in RECORDS] == [
        f"{number:04}" for number in range(1, len(RECORDS) + 1)
    ]


def test_the_index_lists_every_record_with_its_title() -> None:
    """A number may come after a larger one: records are grouped by theme."""
    rows = sorted(re.findall(r"^\| (\d{4}) \| \[(.+)\]\((.+)\) \| .+ \|$", INDEX, re.MULTILINE))
    titles = [path.read_text(encoding="utf-8").splitlines()[0] for path in RECORDS]
    assert [f"# {number} {title}" for number, title, _ in rows] == titles
    assert [name for *_, name in rows] == [path.name for path in RECORDS]


@pytest.mark.parametrize("record", RECORDS, ids=lambda path: path.stem)
def test_a_record_has_all_parts_in_order(record: Path) -> None:
    text = record.read_text(encoding="utf-8")
    assert "\nStatus: accepted. Date" in text
    found = re.findall(r"^\*\*([\w ]+?)\.?\*\*", text, re.MULTILINE)
    assert [one for one in found if one != "Superseded"] == list(PARTS)


def now() -> dict[str, set[str]]:
    """The files that contain each former record, as these files state it."""
    found: dict[str, set[str]] = {}
    for path in RECORDS:
        (head,) = re.findall(
            r"^Status: .*?\n\n", path.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
        )
        for former in re.findall(r"\b0\d{3}\b", head):
            found.setdefault(former, set()).add(path.name)
    for former in re.findall(r"^Former (\d{4}),", HISTORY.read_text(encoding="utf-8"), re.M):
        found.setdefault(former, set()).add(HISTORY.name)
    return found


def test_every_former_number_is_in_the_table() -> None:
    rows = re.findall(r"^\| (\d{4}) \| ((?:, |\[\w+\]\([^)]+\))+) \|$", INDEX, re.MULTILINE)
    table = {
        former: {Path(target.partition("#")[0]).name for target in re.findall(r"\(([^)]+)\)", row)}
        for former, row in rows
    }
    assert len(rows) == FORMER
    assert table == now()
