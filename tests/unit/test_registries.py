"""No file of the checkout names the host of a package registry or a resolved address of one.

Which registry serves a package is a setting of the machine that installs it.
"""

import re
import subprocess

import pytest
from support.programs import program
from support.tree import ROOT

# in two halves, so that this file names none
HOSTS = [
    "".join(halves)
    for halves in (
        ("pypi", ".org"),
        ("python", "hosted.org"),
        ("registry.npm", "js.org"),
        ("registry.yarn", "pkg.com"),
        ("crates", ".io"),
        ("deb.debian", ".org"),
        ("unpkg", ".com"),
        ("jsdelivr", ".net"),
        ("conda.anaconda", ".org"),
    )
]
NAMED = re.compile("|".join(map(re.escape, HOSTS)))


def tracked() -> list[str]:
    """Files that git knows, and new ones that it does not ignore."""
    command = [program("git"), "ls-files", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("this tree is no checkout of git")
    return listed.stdout.splitlines()


def test_no_file_names_the_host_of_a_registry() -> None:
    texts = {name: ROOT / name for name in tracked() if (ROOT / name).is_file()}
    assert len(texts) > 500
    named = [
        f"{name}: {found[0]}"
        for name, path in texts.items()
        if (found := NAMED.search(path.read_text(encoding="utf-8", errors="ignore")))
    ]
    assert named == []


def test_lock_files_of_npm_have_no_resolved_addresses() -> None:
    locks = [ROOT / name for name in tracked() if name.endswith("package-lock.json")]
    assert [lock for lock in locks if '"resolved"' in lock.read_text()] == []


@pytest.mark.parametrize("host", HOSTS)
def test_a_host_that_is_named_is_found(host: str) -> None:
    assert NAMED.search(f"see https://{host}/simple")
