"""Docstrings of the package as reStructuredText, for the reference of the Python interface.

They are plain text: single backticks are code, indented columns are columns, and bars and asterisks
are literal (|Z|, V**2). Sphinx would interpret all of that as markup.
"""

import re
from typing import Any

GIVEN = {"R": "Receipt", "D": "dict"}  # by the variables of `client.commands`
MARKUP = re.compile(r"(`[^`]*`)|([|*\\]|\b_\w|\w_\b)")


def as_text(app: Any, what: str, name: str, target: Any, options: Any, lines: list[str]) -> None:
    """Handle the event `autodoc-process-docstring`: `lines` are changed in place."""
    found: list[str] = []
    for line in lines:
        indented = line.startswith("  ")
        if indented and found and not found[-1].startswith("  ") and found[-1].strip():
            found.append("")
        if indented and not any(one == "::" for one in found[-2:]) and not in_columns(found):
            found += ["::", ""]
        found.append(line if indented else escaped(line))
        if not indented and len(found) > 1 and found[-2].startswith("  ") and line.strip():
            found.insert(-1, "")
    lines[:] = found


def named(
    app: Any,
    what: str,
    name: str,
    target: Any,
    options: Any,
    signature: str | None,
    gives: str | None,
) -> tuple[str | None, str | None]:
    """Handle the event `autodoc-process-signature`: insert the results of the generic commands."""
    if ".Client." in name:
        return signature, GIVEN.get((gives or "").rpartition(".")[2].lstrip("~"), gives)
    return signature, gives


def in_columns(found: list[str]) -> bool:
    """Return whether the last nonempty line belongs to columns."""
    written = [line for line in found if line.strip()]
    return bool(written) and written[-1].startswith("  ")


def escaped(line: str) -> str:
    """Return the line with its markup escaped; text in backticks is code."""

    def plain(mark: re.Match[str]) -> str:
        if mark[1]:
            return f"`{mark[1]}`"
        return "".join(f"\\{letter}" if letter in "|*\\_" else letter for letter in mark[2])

    return MARKUP.sub(plain, line)
