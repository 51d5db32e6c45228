"""200 simulated trials of 90 s, and the envelope of those that pass: the impedances that this
display can render, drawn to envelope.png.

Needs hapticd[fast,plot] and no daemon; takes a few seconds.
"""

from pathlib import Path

import numpy as np

from hapticd.settings.scene import load_scene
from hapticd.zwidth.outcomes import Conditions, run_trials
from hapticd.zwidth.report.envelope import envelope_figure
from hapticd.zwidth.report.style import save


def main(folder: Path, trials: int = 200, seconds: float = 90.0) -> int:
    """Return the number of passed trials."""
    # K N/m, B N s/m, M kg
    lowest = (0.0, 0.0, -0.025)
    highest = (1200.0, 9.0, 0.030)
    environments = np.random.default_rng(1).uniform(lowest, highest, (trials, 3))
    conditions = Conditions(load_scene("fig4"), seconds)
    outcomes = run_trials(conditions, 1.74, environments)  # with 1.74 N s/m of active damping
    save(envelope_figure(conditions, [(1.74, outcomes)]), folder, "envelope")
    return sum(outcome.passes for outcome in outcomes)


if __name__ == "__main__":
    print(main(Path.cwd()), "of 200 pass; see envelope.png")
