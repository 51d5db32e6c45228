"""Folders of the checkout, and the path of a test file in whichever tier it is."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"


def path_of_test(name: str) -> Path:
    """The path of the test file `name`, in whichever tier. LookupError unless there is just one."""
    paths = [path for path in TESTS.glob(f"*/{name}") if path.parent.name != "support"]
    if len(paths) != 1:
        raise LookupError(f"{name} is in {len(paths)} folders of {TESTS}, not in one")
    return paths[0]
