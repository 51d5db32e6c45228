"""Texts of messages, receipts, findings, records and parameters are shown, and decide nothing.

The test reads the source: a string test on an attribute or a key that holds a text fails.
"""

import ast
import re
from collections.abc import Iterator
from typing import Any, get_type_hints

import pytest
from support.tree import ROOT

from hapticd.client.sequence import StepReceipt
from hapticd.core.errors import MailboxError
from hapticd.core.faults import Fault
from hapticd.core.params import ScaleParams
from hapticd.core.process import Grant
from hapticd.model.effects import Effect
from hapticd.protocol.answers import Event, GuardVerdict, LeaseReleased
from hapticd.protocol.journal import Entry
from hapticd.recording.provenance import CalibrationDoubt
from hapticd.rig.result import Finding
from hapticd.run.doctor.checks import CheckResult
from hapticd.signal import findings
from hapticd.zwidth.store import TrialEnd, TrialRecord

TEXTS: dict[type[Any], tuple[str, ...]] = {
    StepReceipt: ("text",),
    GuardVerdict: ("text",),
    Event: ("text", "reason"),
    LeaseReleased: ("text",),
    Entry: ("text",),
    Grant: ("text",),
    TrialEnd: ("text",),
    TrialRecord: ("ended", "origin"),
    findings.Finding: ("message",),
    Finding: ("what", "remedy"),
    CheckResult: ("found", "why", "fix"),
    CalibrationDoubt: ("reason",),
    Fault: ("cause", "remedy"),
    ScaleParams: ("source",),
    Effect: ("note",),
}
NAMES = frozenset(name for names in TEXTS.values() for name in names) | {"sentence", "said"}
TESTS = frozenset(
    ("startswith", "endswith", "removeprefix", "removesuffix", "split", "partition", "rpartition")
)
MATCHES = frozenset(("match", "fullmatch", "search", "findall", "finditer", "split"))
PAGE = re.compile(
    r"\b(?:text|reason|words|remedy|cause)\.(?:includes|startsWith|endsWith|indexOf|match|search|split)\("
)


def _is_text(node: ast.expr, errors: frozenset[str]) -> bool:
    """Whether `node` is a text: an attribute, a key, or the words of an error that was caught."""
    match node:
        case ast.Attribute(attr=name) | ast.Subscript(slice=ast.Constant(value=name)):
            return name in NAMES
        case ast.Call(func=ast.Attribute(attr="get"), args=[ast.Constant(value=name), *_]):
            return name in NAMES
        case ast.Call(func=ast.Name(id="str"), args=[ast.Name(id=name)]):
            return name in errors
        case ast.Call(func=ast.Name(id="str"), args=[inner]):
            return _is_text(inner, errors)
        case ast.BoolOp(values=[first, *_]):
            return _is_text(first, errors)
    return False


def _is_sentence(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value


def _tests(tree: ast.AST) -> Iterator[ast.expr]:
    """Every string test on a text below `tree`."""
    errors = frozenset(
        node.name for node in ast.walk(tree) if isinstance(node, ast.ExceptHandler) and node.name
    )
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr=method, value=value), args=arguments):
                of_re = isinstance(value, ast.Name) and value.id == "re" and method in MATCHES
                if (method in TESTS and _is_text(value, errors)) or (
                    of_re and any(_is_text(one, errors) for one in arguments)
                ):
                    yield node
            case ast.Compare(left=left, ops=[ast.In() | ast.NotIn()], comparators=[right]):
                if _is_text(right, errors) and not isinstance(left, ast.Name):
                    yield node
            case ast.Compare(left=left, ops=[ast.Eq() | ast.NotEq()], comparators=[right]):
                for one, other in ((left, right), (right, left)):
                    if _is_text(one, errors) and _is_sentence(other):
                        yield node


def _found(source: str) -> list[str]:
    return [ast.unparse(node) for node in _tests(ast.parse(source))]


def test_no_text_is_tested() -> None:
    found = {
        f"{path.relative_to(ROOT)}: {one}"
        for folder in ("hapticd", "examples", "benchmarks")
        for path in (ROOT / folder).rglob("*.py")
        for one in _found(path.read_text())
    }
    assert not found


def test_the_page_tests_no_text() -> None:
    folder = ROOT / "hapticd" / "console" / "static"
    found = [
        f"{path.name}: {one.group()}"
        for path in folder.glob("*.js")
        for one in PAGE.finditer(path.read_text())
    ]
    assert not found


@pytest.mark.parametrize(
    "planted",
    [
        "recorded.ended.startswith('escape')",
        "scale['source'].startswith('rig ')",
        "re.search('95 %', device['force']['source'])",
        "'refused' in receipt.text",
        "verdict.get('text', '').split('; ')",
        "(status.get('cause') or '').endswith('lost')",
        "finding.message == 'the force is at its limit'",
        "str(finding.what).partition(':')",
        "try: f()\nexcept E as error: x = str(error).split('; ')",
    ],
)
def test_a_planted_test_is_found(planted: str) -> None:
    assert _found(planted)


@pytest.mark.parametrize(
    "harmless",
    ["effect.source == 'inferred'", "finding.code in CODES", "path.name.endswith('.toml')"],
)
def test_enumerated_values_and_names_of_files_may_be_tested(harmless: str) -> None:
    assert not _found(harmless)


def test_every_text_of_the_list_is_a_field() -> None:
    for kind, names in TEXTS.items():
        assert set(names) <= set(get_type_hints(kind)), kind
    assert MailboxError("a", "b").remedy == "b"


def test_the_page_pattern_finds_a_planted_test() -> None:
    assert PAGE.search('if (told.text.includes("refused"))')
