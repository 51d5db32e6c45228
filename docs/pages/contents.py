"""The contents of the site, from the lists of docs/index.md: the pages stay readable on a code
host, and the site needs no second list.
"""

import re
from typing import Any

# files of the checkout that are pages of the site under another name
INCLUDED = {
    "examples/README.md": "examples",
    "SECURITY.md": "security",
    "firmware_iface/PROTOCOL.md": "protocol",
    "CHANGELOG.md": "changelog",
}
OUTSIDE = re.compile(rf"\]\((?:\.\./)+({'|'.join(map(re.escape, INCLUDED))})")
GENERATED = {
    "Begin": ("generated/tutorials/index",),
    "Reference": (
        "generated/commands",
        "generated/configuration",
        "generated/device",
        "generated/scene",
        "generated/effects",
        "generated/messages",
        "generated/faults/index",
        "generated/simulated-board",
    ),
}


def contents(app: Any, name: str, source: list[str]) -> None:
    """Handle the event `source-read`. Links to files outside of docs/ lead to the pages that
    include them. Each list of the first page becomes a part of the contents.
    """
    above = "../" * name.count("/")
    text = OUTSIDE.sub(lambda link: f"]({above}{INCLUDED[link[1]]}.md", source[0])
    if name == "index":
        first, *parts = text.split("\n## ")
        text = "\n\n".join([first, *map(tree, parts)])
    source[0] = text


def tree(part: str) -> str:
    """Return a part of the contents: its heading, its listed pages, and the generated ones."""
    heading = part.partition("\n")[0]
    pages = re.findall(r"^- \[[^\]]*\]\(([^)]+)\.md\)$", part, re.MULTILINE)
    lines = "\n".join([*pages, *GENERATED.get(heading, ())])
    return f"```{{toctree}}\n:caption: {heading}\n:maxdepth: 1\n\n{lines}\n```"
