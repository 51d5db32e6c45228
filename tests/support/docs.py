"""The documentation repeats all tables of the program, the table of faults is complete, and the
site builds.
"""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from hapticd.core.faults import FAULTS

CODES = [fault.code for fault in FAULTS if fault.number]


def page(site: Path, name: str) -> str:
    return (site / "generated" / name).read_text()


class Links(HTMLParser):
    """The references of a page, and its anchors."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.targets: set[str] = set()
        self.places: set[str] = {""}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """A link, a picture, a script, or a place."""
        for name, value in attrs:
            if name in ("href", "src") and value and not value.startswith("data:"):
                self.targets.add(value)
            elif name == "id" and value:
                self.places.add(value)


def broken(root: Path) -> list[str]:
    """Links of the pages below `root` that lead to no file, or to no place in a page."""
    pages = {path: Links(path.read_text(encoding="utf-8")) for path in root.rglob("*.html")}
    found = []
    for path, links in pages.items():
        for target in links.targets:
            url = urlsplit(target)
            if url.scheme or url.netloc:
                continue
            to = (path.parent / unquote(url.path)).resolve() if url.path else path
            lost = to in pages and unquote(url.fragment) not in pages[to].places
            if lost or not to.is_file():
                found.append(f"{path.relative_to(root)}: {target}")
    return sorted(found)
