"""Put known defects back, one at a time, and see that a test fails for each: `make mutate`.

A patch of tests/mutations is one defect that was found and mended, or that tests once did not see.
Its header, before the diff, says what is no longer true and which tests must notice:

    Claim: an old frame is known to be old
    Killed by: test_link_device.py::test_frames_of_a_queue_are_read_past_down_to_the_newest

Every test that a header names first passes on an untouched copy of the tree. Then each patch goes
into a copy of its own, its tests run, and the verdict is

    killed           a named test fails
    survived         all of them pass: nothing guards the claim any more
    does not apply   the code has moved on: make the patch anew, the claim stays
    does not run     the tests could not even be collected

All but `killed` fail the run. Copies share bytecode that is checked by the hash of its source: by
time and size, two texts of one length within one second would be the same.

    python tests/mutate.py                   all of them, two at a time
    python tests/mutate.py old_frame stop    those whose file name holds one of the words

What would break it: a patch that kills by an import error (it would say `does not run`), a test
that depends on files outside the tree.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from compileall import compile_dir
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "tests" / "mutations"
LEFT_OUT = shutil.ignore_patterns(".*", "build", "dist", "__pycache__", "*.egg-info")
WORKERS = 2
TIMEOUT_S = 900.0
PASSED = 0  # exit codes of pytest
FAILED = 1


class Mutation(NamedTuple):
    """One defect: its patch, what is then no longer true, and who must notice."""

    path: Path
    claim: str
    tests: tuple[str, ...]


class Outcome(NamedTuple):
    """What became of a patch, and what was printed if it was not killed."""

    verdict: str
    seconds: float
    text: str = ""


def read(path: Path) -> Mutation:
    """The patch at `path`. SystemExit if its header is not complete."""
    fields: dict[str, str] = {}
    key = ""
    for line in path.read_text().splitlines():
        if line.startswith(("diff ", "--- ")):
            break
        name, colon, value = line.partition(": ")
        if colon and name in ("Claim", "Killed by"):
            key = name
            fields[key] = value
        elif key:
            fields[key] += f" {line.strip()}"
    if set(fields) != {"Claim", "Killed by"}:
        raise SystemExit(f"{path}: the header needs `Claim: ` and `Killed by: `")
    return Mutation(path, fields["Claim"], tuple(fields["Killed by"].split()))


def prepared(folder: Path) -> Path:
    """A copy of the tree in `folder`, with bytecode of the package."""
    copy = folder / "tree"
    shutil.copytree(ROOT, copy, ignore=LEFT_OUT, symlinks=True)
    compile_dir(
        copy / "hapticd",
        quiet=2,
        invalidation_mode=PycInvalidationMode.CHECKED_HASH,
        workers=WORKERS,
    )
    return copy


def pytest(tree: Path, tests: Iterable[str]) -> subprocess.CompletedProcess[str]:
    """`tests` in `tree`, up to the first that fails."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    environment = os.environ | {"PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        command,
        cwd=tree,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
        check=False,
    )


def tried(mutation: Mutation, original: Path) -> Outcome:
    """Patch a copy, run the tests that must fail."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="hapticd-mutate-") as folder:
        tree = Path(shutil.copytree(original, Path(folder) / "tree", symlinks=True))
        apply = ["git", "apply", "--whitespace=nowarn", str(mutation.path)]
        patched = subprocess.run(apply, cwd=tree, capture_output=True, text=True, check=False)
        if patched.returncode:
            return Outcome("does not apply", time.monotonic() - begin, patched.stderr)
        ran = pytest(tree, mutation.tests)
    verdict = {PASSED: "survived", FAILED: "killed"}.get(ran.returncode, "does not run")
    text = "" if verdict == "killed" else ran.stdout[-2000:] + ran.stderr[-1000:]
    return Outcome(verdict, time.monotonic() - begin, text)


def untouched_fails(mutations: Sequence[Mutation], original: Path) -> str:
    """What pytest says if a named test does not pass on the tree as it is; empty if all do."""
    ran = pytest(original, sorted({test for one in mutations for test in one.tests}))
    return "" if ran.returncode == PASSED else ran.stdout[-3000:] + ran.stderr[-1000:]


def told(mutation: Mutation, outcome: Outcome) -> bool:
    """Print the verdict; whether the defect was noticed."""
    verdict, seconds, text = outcome
    why = f"  ({mutation.claim})\n{text}" if text else ""
    print(f"{verdict:>14} {seconds:4.0f} s  {mutation.path.stem}{why}", flush=True)
    return verdict == "killed"


def main(words: Sequence[str]) -> int:
    """Try the patches whose name holds one of `words`, all without; 1 if any was not killed."""
    paths = sorted(FOLDER.glob("*.patch"))
    chosen = [one for one in paths if not words or any(word in one.name for word in words)]
    mutations = [read(path) for path in chosen]
    if not mutations:
        raise SystemExit(f"no patch in {FOLDER} has one of {', '.join(words)} in its name")
    with tempfile.TemporaryDirectory(prefix="hapticd-mutate-") as folder:
        original = prepared(Path(folder))
        with ThreadPoolExecutor(WORKERS) as pool:
            untouched = pool.submit(untouched_fails, mutations, original)
            outcomes = pool.map(lambda one: tried(one, original), mutations)
            killed = sum(told(*pair) for pair in zip(mutations, outcomes, strict=True))
        if text := untouched.result():
            print(f"without any patch a named test does not pass:\n{text}")
            return 1
    print(f"{killed} of {len(mutations)} killed")
    return int(killed < len(mutations))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
