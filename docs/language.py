"""Count patterns of unidiomatic English in each page: `python docs/language.py [PAGE ...]`.

The twenty rules of CONTRIBUTING.md replace these patterns. Code, quotations, tables of the safety
case and decision records are left out. A count shows where to read again. It is not a limit, since
most patterns are right in some sentence.
"""

import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
MOST_WORDS = 25  # in a sentence
PATTERNS = {
    "noun clause": r"\bwhat (?:is|are|was|were|has|have|it|they|a|an|the)\b[^?]*$|^What\b[^?]*$",
    "person": r"\b(?:no|any|some|every)(?:body|one)\b|\bwho(?:so)?ever\b|\bno one\b",
    "speech": r"\b(?:say|says|said|tell|tells|told|hear|hears|heard|think|thinks|thought)\b",
    "is no": r"\b(?:is|are|was|were|be) no\b",
    "else": r"\belse\b",
    "by": r"\bby (?:theorem|name|date|hash|that of|those of|its own|the dozen)\b",
    "false friend": r"\b(?:anew|mend\w*|renew\w*|bears?|bring(?:s|ing)? in|beside|to and fro"
    r"|stands? (?:in|at|beside|behind|on)|(?:come|comes|came) into force|goes off|takes? away)\b",
    "margin": r"\b(?:to spare|short at|would do|will do)\b",
    "hand": r"\b(?:hand|somebody|it|them|which)\b[^.]{0,40}\bshakes?\b|\bshaken\b",
    "so much": r"\bso (?:many|much|long)\b",
    "bare": r"\b(?:greatest|dozen|least)\b|\bsome \d",
    "inverted": r"^(?:Refused|Found|Gone|Promised|Lost|Shown|Held|Taken|Tried|Counted)\b",
}
SENTENCE_END = re.compile(r"(?<=[.!?])\**\s+(?=[A-Z*\[`]|hapticd\b)|(?<=:)\s+(?=[A-Z]\w+ )")
PAGES = ("*.md", "docs/*.md", "docs/development/*.md", "docs/faults/*.md", "examples/*.md")
LEFT_OUT = ("CHANGELOG.md",)
SAFETY_CASE = re.compile(r"^\|.*`test_\w+\.py::.*$", re.MULTILINE)


class Count(NamedTuple):
    """Counts of one page, or of several."""

    words: int
    sentences: int
    long: int
    chains: int
    patterns: tuple[int, ...]

    def __add__(self, other: tuple[object, ...]) -> "Count":
        assert isinstance(other, Count)
        both = zip(self.patterns, other.patterns, strict=True)
        sums = (a + b for a, b in zip(self[:4], other[:4], strict=True))
        return Count(*sums, tuple(a + b for a, b in both))


NOTHING = Count(0, 0, 0, 0, (0,) * len(PATTERNS))


def prose(page: str) -> str:
    """Return `page` without code, quotations, comments, link targets and the rows of the safety
    case.
    """
    page = re.sub(r"^(```|~~~).*?^\1", "", page, flags=re.MULTILINE | re.DOTALL)
    page = re.sub(r"<!--.*?-->", "", page, flags=re.DOTALL)
    page = SAFETY_CASE.sub("", page)
    page = re.sub(r"^(?: {4}|>).*$", "", page, flags=re.MULTILINE)
    page = re.sub(r"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\([^)]*\)", r"\1", page)
    page = re.sub(r'"[^"\n]{1,200}"', '"x"', page)
    return re.sub(r"`[^`]+`", "X", page)


def sentences(text: str) -> list[str]:
    """Return sentences of running text, list items, headings and cells of tables."""
    found: list[str] = []
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=[#|])", text):
        if block.lstrip().startswith("|"):
            found += [cell for row in block.splitlines() for cell in row.split("|")]
        else:
            line = " ".join(block.split()).lstrip("#-* ")
            found += SENTENCE_END.split(line)
    return [one.strip() for one in found if re.search(r"[A-Za-z]{2}", one)]


def count(page: str) -> Count:
    """Return the counts of the Markdown text `page`."""
    found = sentences(prose(page))
    lengths = [len(re.findall(r"[\w'’–./-]*\w", one)) for one in found]
    hits = (
        sum(len(re.findall(pattern, one, re.IGNORECASE)) for one in found)
        for pattern in PATTERNS.values()
    )
    return Count(
        sum(lengths),
        len(found),
        sum(length > MOST_WORDS for length in lengths),
        sum(one.count(";") > 1 for one in found),
        tuple(hits),
    )


def row(name: str, found: Count) -> str:
    """Return one line of the table."""
    cells = (found.words, found.sentences, found.long, found.chains, *found.patterns)
    total = found.chains + sum(found.patterns)
    return f"{name:34}" + "".join(f"{cell:>8}" for cell in (*cells, total))


def report(paths: Iterable[Path]) -> str:
    """Return the table of `paths`, with a last line for all of them."""
    names = ("words", "sent.", f">{MOST_WORDS}", "chains", *PATTERNS, "total")
    lines = [f"{'page':34}" + "".join(f"{name[:7]:>8}" for name in names)]
    total = NOTHING
    for path in paths:
        found = count(path.read_text(encoding="utf-8"))
        total += found
        shown = path.relative_to(ROOT) if path.is_relative_to(ROOT) else path
        lines.append(row(str(shown), found))
    return "\n".join([*lines, row("all", total)])


def pages() -> list[Path]:
    """Return the pages for readers, without decision records and the change log."""
    found = (path for pattern in PAGES for path in sorted(ROOT.glob(pattern)))
    return [path for path in found if path.name not in LEFT_OUT]


if __name__ == "__main__":
    asked = [Path(name).resolve() for name in sys.argv[1:]]
    sys.stdout.write(f"{report(asked or pages())}\n")
