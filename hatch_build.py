"""The README of wheel and sdist, which stands alone there: a package index has no other file.

With `Repository` in [project.urls] links and pictures point into that repository, at the tag of the
version. Without it links become their words, and pictures are left out.
"""

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

PICTURE = re.compile(r"!\[(?P<words>[^\]]*)\]\((?P<target>[^)\s]+)\)\n*")
LINK = re.compile(r"(?<!!)\[(?P<words>[^\]]+)\]\((?P<target>[^)\s]+)\)")
ABSOLUTE = ("http://", "https://", "mailto:")


def alone(text: str, repository: str, version: str) -> str:
    """The README `text` without a link that needs another file beside it."""

    def placed(found: re.Match[str], kind: str) -> str:
        target = found["target"]
        if target.startswith(ABSOLUTE):
            return found[0]
        if not repository:
            return "" if kind == "raw" else found["words"]
        return found[0].replace(f"({target})", f"({repository}/{kind}/v{version}/{target})")

    pictured = PICTURE.sub(lambda found: placed(found, "raw"), text)
    return LINK.sub(lambda found: placed(found, "blob"), pictured)


class CustomMetadataHook(MetadataHookInterface):
    """Puts it into the metadata."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Set `readme`, which pyproject.toml declares as dynamic."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        version = re.search(
            r'^__version__ = "([^"]+)"', Path(self.root, "hapticd/__init__.py").read_text(), re.M
        )
        assert version is not None
        repository = metadata.get("urls", {}).get("Repository", "").rstrip("/")
        content = alone(text, repository, version[1])
        metadata["readme"] = {"content-type": "text/markdown", "text": content}
