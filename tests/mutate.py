"""Insert known defects, one at a time, and check that a test fails for each: `make mutate`.

A mutant of tests/mutants is one defect that was found and corrected, or that tests once missed;
support.mutants documents the format. Every test that a mutant names first passes on an untouched
copy of the tree. Then each mutant is inserted into a copy, its tests run, and it is taken out. The
verdict is

    killed           a named test fails
    survived         all of them pass: no test guards the claim any more
    does not apply   the code has changed: write the mutant again, the claim stays
    does not run     the tests could not be collected

All but `killed` fail the run. Copies share bytecode that is checked by the hash of its source: by
time and size, two texts of one length within one second would be the same.

    python tests/mutate.py                   all of them, two at a time
    python tests/mutate.py old_frame stop    those whose name contains one of the words

Limitations: a mutant that kills by an import error reports `does not run`; a test that depends on
files outside the tree cannot be named.
"""

import os
import queue
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

from support.mutants import FOLDER, DoesNotApply, Mutant, mutants, mutated
from support.tree import ROOT, path_of_test

LEFT_OUT = shutil.ignore_patterns(".*", "build", "dist", "__pycache__", "*.egg-info")
WORKERS = 2
TIMEOUT_S = 900.0
PASSED = 0  # exit codes of pytest
FAILED = 1


class Outcome(NamedTuple):
    """The verdict on a mutant, and the output of pytest if it was not killed."""

    verdict: str
    seconds: float
    text: str = ""


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
    with tempfile.TemporaryDirectory(prefix="hapticd-mutate-") as examples:
        environment = os.environ | {
            "PYTHONPATH": str(tree),
            "PYTHONDONTWRITEBYTECODE": "1",
            "HYPOTHESIS_STORAGE_DIRECTORY": examples,  # no counterexample of another mutant
        }
        return subprocess.run(
            command,
            cwd=tree,
            env=environment,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )


def paths(mutants: Iterable[Mutant]) -> list[str]:
    """Return the tests of the mutants, each once, as pytest accepts them in the tree."""
    named = sorted({test.partition("::")[::2] for one in mutants for test in one.tests})
    return [f"{path_of_test(file).relative_to(ROOT)}::{test}" for file, test in named]


def tried(mutant: Mutant, tree: Path) -> Outcome:
    """Put the mutant into the copy `tree`, run the tests that must fail, and take it out again."""
    begin = time.monotonic()
    file = tree / mutant.file
    text = file.read_text()
    try:
        file.write_text(mutated(mutant, text))
        ran = pytest(tree, paths([mutant]))
    except DoesNotApply as reason:
        return Outcome("does not apply", time.monotonic() - begin, str(reason))
    finally:
        file.write_text(text)
    verdict = {PASSED: "survived", FAILED: "killed"}.get(ran.returncode, "does not run")
    text = "" if verdict == "killed" else ran.stdout[-2000:] + ran.stderr[-1000:]
    return Outcome(verdict, time.monotonic() - begin, text)


def untouched_fails(chosen: Sequence[Mutant], original: Path) -> str:
    """Return the output of pytest if a named test fails on the unchanged tree; else an
    empty text.
    """
    ran = pytest(original, paths(chosen))
    return "" if ran.returncode == PASSED else ran.stdout[-3000:] + ran.stderr[-1000:]


def show(mutant: Mutant, outcome: Outcome) -> bool:
    """Print the verdict; whether the defect was noticed."""
    verdict, seconds, text = outcome
    why = f"  ({mutant.claim})\n{text}" if text else ""
    print(f"{verdict:>14} {seconds:4.0f} s  {mutant.name}{why}", flush=True)
    return verdict == "killed"


def main(words: Sequence[str]) -> int:
    """Test the mutants whose name contains one of `words`, or all; return 1 if any was
    not killed.
    """
    chosen = [one for one in mutants() if not words or any(word in one.name for word in words)]
    if not chosen:
        raise SystemExit(f"no mutant of {FOLDER} has one of {', '.join(words)} in its name")
    with tempfile.TemporaryDirectory(prefix="hapticd-mutate-") as folder:
        original = prepared(Path(folder))
        trees: queue.SimpleQueue[Path] = queue.SimpleQueue()
        for number in range(WORKERS):
            copy = Path(folder) / f"tree-{number}"
            trees.put(Path(shutil.copytree(original, copy, symlinks=True)))

        def tried_in_one(mutant: Mutant) -> Outcome:
            tree = trees.get()
            try:
                return tried(mutant, tree)
            finally:
                trees.put(tree)

        with ThreadPoolExecutor(WORKERS) as pool:
            untouched = pool.submit(untouched_fails, chosen, original)
            outcomes = pool.map(tried_in_one, chosen)
            killed = sum(show(*pair) for pair in zip(chosen, outcomes, strict=True))
        if text := untouched.result():
            print(f"without any mutant a named test does not pass:\n{text}")
            return 1
    print(f"{killed} of {len(chosen)} killed")
    return int(killed < len(chosen))


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
