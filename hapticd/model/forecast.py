"""Everything known about one environment before a trial: eigenvalues, theorem, prediction, hands.

    radius       of the exact tick without friction: at 1 and above the display moves by itself
    theorem      damping margin at every image, for every input, without friction (`theorem`)
    prediction   minimum Re Z at a given perturbation, Coulomb friction linearised there (`predict`)
    hand         without friction, a passive hand in which the loop grows (`coupled`), checked by
                 its tick

The theorem covers all inputs and large motions; the prediction covers a trial of that amplitude.
They differ where friction stabilises a display, or where noise does not show images.

Limitations: K < 0. It is active below every judged band, so Re Z >= 0 proves nothing, and the loop
may be unstable with Re Z > 0 over the whole band. It is refused whatever the numbers.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hapticd.model.coupled import DestabilisingHand, coupled_stable, shaking_hand
from hapticd.model.linearise import Perturbation
from hapticd.model.loop import Filters, spectral_radius
from hapticd.model.model import Model
from hapticd.model.predict import Prediction, environments, predict
from hapticd.model.rational import positive_everywhere, rational
from hapticd.model.theorem import lifted_margin, lifted_system

__all__ = ["Forecast", "forecast"]


@dataclass(frozen=True, eq=False)
class Forecast:
    """Everything known about one environment before a trial."""

    period_s: float  # of a tick
    radius: float  # spectral radius of a tick without friction
    theorem_margin: float  # damping margin, N s/m
    theorem_passive: bool  # includes stability, which the theorem assumes
    withstands: bool  # whether no passive hand makes it oscillate
    # None if it withstands, is unstable without a hand, or no hand was found
    shaker: DestabilisingHand | None
    true: Prediction  # of Z itself, K < 0 allowed
    recorded: Prediction  # of Z as the probe's channels record it, K < 0 allowed

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable without friction and hand."""
        return self.radius < 1.0

    @property
    def refused(self) -> bool:
        """Whether it is refused whatever the numbers: K < 0."""
        return bool(self.true.points[0, 0] < 0.0)

    @property
    def passive(self) -> bool:
        """Whether it is predicted passive at the given perturbation."""
        return bool(self.true.passive[0]) and not self.refused


def forecast(
    model: Model,
    point: npt.ArrayLike,
    active_damping_ns_per_m: float,
    filters: Filters,
    perturbation: Perturbation,
    band_hz: tuple[float, float],
) -> Forecast:
    """Judge `point` (K [N/m], B [N s/m], M [kg]) on `model` before any trial. AnalysisError unless
    these are finite.
    """
    kbm = environments(np.atleast_2d(np.asarray(point, np.float64)))
    lifted = lifted_system(model, active_damping_ns_per_m, filters)
    radius = float(spectral_radius(model, kbm, active_damping_ns_per_m, filters)[0])
    safe = radius < 1.0 and bool(kbm[0, 0] >= 0.0 and coupled_stable(lifted, kbm)[0])
    sought = radius < 1.0 and not safe and kbm[0, 0] >= 0.0
    proven = positive_everywhere(rational(model, active_damping_ns_per_m, filters, 0.0), kbm)
    true, recorded = (
        predict(model, kbm, active_damping_ns_per_m, filters, perturbation, band_hz, True, seen)
        for seen in (False, True)
    )  # fmt: skip
    return Forecast(
        period_s=1.0 / model.rate_hz,
        radius=radius,
        theorem_margin=float(lifted_margin(lifted, kbm)[0]),
        theorem_passive=radius < 1.0 and bool(kbm[0, 0] >= 0.0 and proven[0]),
        withstands=safe,
        shaker=shaking_hand(model, kbm[0], active_damping_ns_per_m, filters) if sought else None,
        true=true,
        recorded=recorded,
    )
