"""Thirty recorded trials with hidden truth: make them, judge them with hapticd, score the verdicts
of any estimator.

Exit codes are those of `hapticd`. See docs/trials.md.
"""

import json
import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Sequence
from math import isfinite
from pathlib import Path

from examples.trials.files import make
from examples.trials.judge import judge, verdicts_csv
from examples.trials.plan import SECONDS, specs
from examples.trials.score import read_truth, read_verdicts, score, score_json, score_table
from hapticd.cli.terminal import progress, talk
from hapticd.core.errors import HapticdError
from hapticd.core.extras import need
from hapticd.zwidth.report.paper import text

INTERRUPTED = 130
SHORTEST_S, LONGEST_S = 8.0, 300.0


def parsed(arguments: Sequence[str]) -> Namespace:
    """Return the verb and its options."""
    parser = ArgumentParser("python -m examples.trials", description=__doc__, allow_abbrev=False)
    verbs = parser.add_subparsers(dest="verb", required=True)
    making = verbs.add_parser("make", help="simulate the trials: CSV, npz and truth.json")
    making.add_argument("--out", metavar="FOLDER", type=Path, required=True)
    making.add_argument(
        "--seconds",
        metavar="S",
        type=length_s,
        default=SECONDS,
        help=f"length of each (default {SECONDS:g}, which keeps all below 20 MB)",
    )
    judging = verbs.add_parser("judge", help="print hapticd's verdicts as `score` reads them")
    judging.add_argument("folder", metavar="FOLDER", type=Path)
    scoring = verbs.add_parser("score", help="compare verdicts with the truth")
    scoring.add_argument("verdicts", metavar="VERDICTS.csv", type=Path)
    scoring.add_argument("--truth", metavar="FOLDER/truth.json", type=Path, required=True)
    scoring.add_argument("--json", action="store_true", help="one JSON object on stdout")
    return parser.parse_args(arguments)


def length_s(words: str) -> float:
    """Return the length [s] in the text of --seconds."""
    try:
        seconds = float(words)
    except ValueError:
        raise ArgumentTypeError(f"{words!r} is not a number of seconds") from None
    if not (isfinite(seconds) and SHORTEST_S <= seconds <= LONGEST_S):
        raise ArgumentTypeError(f"{words} s is not in the range {SHORTEST_S:g} to {LONGEST_S:g} s")
    return seconds


def main(arguments: Sequence[str]) -> int:
    """Perform the requested verb and return the exit code."""
    asked = parsed(arguments)
    try:
        {"make": made, "judge": judged, "score": shown}[asked.verb](asked)
    except KeyboardInterrupt:
        talk("interrupted; what `make` wrote so far is not whole: run it again")
        return INTERRUPTED
    except HapticdError as error:
        talk(f"trials: {error}")
        return error.exit_code
    return 0


def made(asked: Namespace) -> None:
    """Make the trials."""
    need("numba", "the batch engine")
    with progress() as tell:
        files = make(asked.out, specs(), asked.seconds, tell)
    size = sum(file.stat().st_size for file in files)
    talk(f"{len(files)} files, {1e-6 * size:.1f} MB in {asked.out}")


def judged(asked: Namespace) -> None:
    """Print the verdicts of hapticd."""
    with progress() as tell:
        found = judge(asked.folder, tell)
    print(verdicts_csv(found), end="")


def shown(asked: Namespace) -> None:
    """Print the score."""
    found = score(read_verdicts(asked.verdicts), read_truth(asked.truth))
    print(json.dumps(score_json(found)) if asked.json else text(score_table(found)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
