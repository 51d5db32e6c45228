"""Every field and flag of a tick's record is described, and docs/analysis.md has the tables."""

import importlib
from types import ModuleType

import pytest
from support.tree import ROOT

from hapticd.core.units import unit_of
from hapticd.mailbox.layout import TELEMETRY, Flag, LateCause


@pytest.fixture
def records(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(ROOT / "docs")
    return importlib.import_module("pages.records")


def test_every_field_and_bit_is_described(records: ModuleType) -> None:
    assert list(records.FIELDS) == [name for name, *_ in TELEMETRY]
    assert list(records.FLAGS) == [flag.name for flag in Flag]
    assert list(records.LATE_CAUSES) == [cause.name for cause in LateCause]
    assert {field: set(values) for field, values in records.bits().items()} == {
        field: set(meanings) for field, meanings in records.MEANINGS.items()
    }


def test_tables_of_the_page_on_recordings_are_those_of_the_program(
    records: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When this fails: `python docs/generate.py` writes them again."""
    generate = importlib.import_module("generate")
    text = (ROOT / "docs" / "analysis.md").read_text()
    assert generate.analysis_page(text) == text
    for name, *_ in TELEMETRY:
        assert f"| `{name}` | {records.UNITS.get(name, unit_of(name))} |" in text
