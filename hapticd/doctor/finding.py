"""What a check says."""

from typing import NamedTuple

OK, WARN, FAIL = "ok", "warn", "fail"


class Finding(NamedTuple):
    """One line: what was found, and unless it is ok, why it matters and the exact fix."""

    name: str
    level: str
    found: str
    why: str = ""
    fix: str = ""


def ok(name: str, found: str) -> Finding:
    """Nothing to do."""
    return Finding(name, OK, found)


def warn(name: str, found: str, why: str, fix: str) -> Finding:
    """It works, and could be better."""
    return Finding(name, WARN, found, why, fix)


def fail(name: str, found: str, why: str, fix: str) -> Finding:
    """The servo misses something it needs."""
    return Finding(name, FAIL, found, why, fix)
