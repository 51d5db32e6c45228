"""Where trials escape, learnt from which of them did: one number, the least headroom of a stable
trial.

A loop that only friction keeps stable escapes in a burst of its own motion. Whether it does within
90 s is not in Re Z, and it is abrupt: of trials on one side of the boundary all escape, on the
other none. Some headroom, a number for every environment that falls towards the boundary, is known
beforehand (`foresight`); how much of it a trial needs is not. Trials tell:

    P(stable) = 1 / (1 + exp(-(headroom - least) / width)),   least ~ N(0, SPREAD^2)

`least` is the mean of its posterior at the likeliest width. A trial on the boundary halves what is
open, as in a bisection; where chance decides, many trials there settle where one half of them
escape.

What would break it: a headroom that orders environments wrongly; then one number cannot tell them
apart.
"""

import numpy as np

from hapticd.analysis.arrays import Flags, Floats

SPREAD = 0.3  # of the least headroom before any trial: the prediction may be off by so much
WIDTHS = (0.01, 0.02, 0.04, 0.08)
# of the width: its median, and the standard deviation of its logarithm
_USUAL_WIDTH = 0.02
_WIDTH_SPREAD = 1.0
_LEAST = np.linspace(-1.0, 1.0, 401)


def least_headroom(headroom: Floats, stable: Flags) -> float:
    """From the headroom (n,) of trials and whether each was stable (n,); 0 without trials."""
    return max(_posterior(headroom, stable, width) for width in WIDTHS)[1]


def _posterior(headroom: Floats, stable: Flags, width: float) -> tuple[float, float]:
    """(log of evidence for `width`, mean of the least headroom)."""
    beyond = (headroom[:, None] - _LEAST) / width
    seen = -np.logaddexp(0.0, np.where(stable[:, None], -beyond, beyond)).sum(axis=0)
    logs = seen - 0.5 * (_LEAST / SPREAD) ** 2
    share = np.exp(logs - logs.max())
    unusual = 0.5 * (np.log(width / _USUAL_WIDTH) / _WIDTH_SPREAD) ** 2
    return float(logs.max() + np.log(share.sum()) - unusual), float(
        (share * _LEAST).sum() / share.sum()
    )
