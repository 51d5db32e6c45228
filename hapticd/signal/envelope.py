"""The Z-width as the paper draws it: at every frequency the largest and smallest passive |Z| and
phase.

"The Z-width envelope is iteratively updated as successive trials are performed" (Weir, Colgate and
Peshkin 2008, section 2). Every point keeps the trial that set it and the uncertainty of that trial,
so each feature can be traced to a trial. Trials that are not passive do not widen the envelope. The
uncertainty is that of the owner alone. The largest of many noisy values exceeds the true maximum by
about one of its standard deviations, so confirm an owner with a second trial before quoting it.

The envelope of the admittance has maximum and minimum exchanged: 1/|Z|, minus the phase.

Trials on other frequencies, at another port or with another estimator are refused.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from hapticd.core.arrays import Complexes, Floats, Integers
from hapticd.core.errors import AnalysisError
from hapticd.signal.verdict import Verdict

__all__ = ["Edge", "Envelope", "accepted", "admittance", "merged", "of_one", "of_predicted"]

Accept = Literal["judged", "within_90_deg"]


@dataclass(frozen=True, eq=False)
class Edge:
    """One edge of the envelope."""

    value: Floats  # (F,) in the unit of the envelope's kind, or degrees
    sd: Floats  # (F,) standard deviation of the owner's estimate: of the logarithm, or degrees
    owner: Integers  # (F,) places in the envelope's `trials`


@dataclass(frozen=True, eq=False)
class Envelope:
    """Upper and lower edges of |Z| or |Y| over `frequency_hz` (F,), and of their phase.

    `trials` are the names of the trials in the order of adding; owners are indices into them.
    """

    frequency_hz: Floats
    upper: Edge  # N s/m or m/(N s)
    lower: Edge  # N s/m or m/(N s)
    phase_upper: Edge  # deg
    phase_lower: Edge  # deg
    trials: tuple[str, ...]
    port: str  # where force and velocity were measured
    estimator: str
    kind: str = "impedance"  # "impedance" or "admittance"

    def width_db(self) -> Floats:
        """Return 20 log10 of upper over lower edge (F,)."""
        return np.asarray(20.0 * np.log10(self.upper.value / self.lower.value))

    def owner(self, edge: Edge) -> list[str]:
        """Return the names of the trials that own the points of `edge`."""
        return [self.trials[index] for index in edge.owner]


def accepted(verdict: Verdict, accept: Accept = "judged") -> bool:
    """Whether a trial is accepted: as judged, or by the paper's rule. That rule rejects an unstable
    trial and one that lost an edge of its band.
    """
    if accept == "judged":
        return verdict.answer == "passive"
    return verdict.within_90_deg and verdict.whole_band and verdict.stability != "unstable"


def of_one(
    name: str, frequency_hz: Floats, z: Complexes, relative_sd: Floats, port: str, estimator: str
) -> Envelope:
    """Return the envelope of one Z (F,) [N s/m] at `frequency_hz` (F,). `relative_sd` (F,) is the
    standard deviation of ln|Z| and of the phase in radians.
    """
    owner = np.zeros(frequency_hz.size, np.int64)
    size = Edge(np.abs(z), relative_sd, owner)
    phase = Edge(np.degrees(np.angle(z)), np.degrees(relative_sd), owner)
    return Envelope(frequency_hz, size, size, phase, phase, (name,), port, estimator)


def of_predicted(frequency_hz: Floats, z: Complexes) -> Envelope:
    """Return the envelope of predicted Z (N, F) [N s/m], without uncertainty; owners: indices
    (N,).
    """
    size = np.abs(z)
    angle = np.degrees(np.angle(z))
    none = np.zeros(frequency_hz.size)

    def edge(values: Floats, which: Integers) -> Edge:
        return Edge(np.take_along_axis(values, which[None], 0)[0], none, which)

    return Envelope(
        frequency_hz,
        edge(size, size.argmax(0)), edge(size, size.argmin(0)),
        edge(angle, angle.argmax(0)), edge(angle, angle.argmin(0)),
        tuple(str(place) for place in range(len(z))), "probe", "spa",
    )  # fmt: skip


def merged(found: Envelope, new: Envelope) -> Envelope:
    """Return the envelope of the trials of both. AnalysisError if frequencies, ports or estimators
    differ.
    """
    if found.kind != "impedance":
        raise AnalysisError(
            "an admittance envelope cannot be widened; widen the impedance envelope and take its"
            " admittance"
        )
    _alike(found, new)
    before = len(found.trials)
    return replace(
        found,
        upper=_outer(found.upper, new.upper, before, 1.0),
        lower=_outer(found.lower, new.lower, before, -1.0),
        phase_upper=_outer(found.phase_upper, new.phase_upper, before, 1.0),
        phase_lower=_outer(found.phase_lower, new.phase_lower, before, -1.0),
        trials=(*found.trials, *new.trials),
    )


def admittance(found: Envelope) -> Envelope:
    """Return the envelope of Y = 1/Z; for an admittance envelope, that of Z."""
    kind = "admittance" if found.kind == "impedance" else "impedance"
    turned = [replace(edge, value=1.0 / edge.value) for edge in (found.lower, found.upper)]
    phases = [replace(edge, value=-edge.value) for edge in (found.phase_lower, found.phase_upper)]
    return replace(
        found,
        upper=turned[0],
        lower=turned[1],
        phase_upper=phases[0],
        phase_lower=phases[1],
        kind=kind,
    )


def _outer(old: Edge, new: Edge, before: int, sense: float) -> Edge:
    beyond = ~(sense * new.value <= sense * old.value) & np.isfinite(new.value)
    return Edge(
        np.where(beyond, new.value, old.value),
        np.where(beyond, new.sd, old.sd),
        np.where(beyond, new.owner + before, old.owner),
    )


def _alike(found: Envelope, new: Envelope) -> None:
    if not np.array_equal(found.frequency_hz, new.frequency_hz):
        raise AnalysisError(
            "trials on unlike frequencies: estimate all with one window and one list of frequencies"
        )
    if (found.port, found.estimator) != (new.port, new.estimator):
        raise AnalysisError(
            f"a trial at the {new.port} by {new.estimator!r} beside others at the {found.port} by"
            f" {found.estimator!r}: choose one"
        )
