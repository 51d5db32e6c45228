"""`hapticd zwidth`: input, output and files of the run folder. Mistakes are named, and no run
starts.
"""

from hapticd.cli.app import main
from support.measured_scenes import GRID_OF_27

SHORT = ["--seconds", "20"]


def run(arguments, capsys):
    """(exit code, stdout, stderr)"""
    code = main(["zwidth", *arguments])
    told = capsys.readouterr()
    return code, told.out, told.err


def small_map(folder, *more):
    """A map of 27 points at one damping level."""
    return [
        "map",
        *SHORT,
        "--out",
        str(folder),
        "--active-damping",
        "1.74",
        *GRID_OF_27,
        "--everywhere",
        "--no-plot",
        *more,
    ]


def trials(folder):
    """Lines of a store, in no order."""
    return sorted((folder / "trials.jsonl").read_text().splitlines())


OUTCOME = {
    "type",
    "environment",
    "active_damping_ns_per_m",
    "answer",
    "passes",
    "margin_ns_per_m",
    "margin_lower",
    "margin_upper",
    "worst_hz",
    "first_judged_hz",
    "last_judged_hz",
}
