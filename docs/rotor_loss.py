"""Effect of a rate-independent loss at the rotor on the six limits: `python docs/rotor_loss.py`
fills the table of docs/reproduction.md; some minutes, or as part of `make reproduction-docs`.

Iron losses and leads dissipate the same energy in each cycle at any frequency. That is a force h /
omega per velocity, Re Z = h / omega with h in N/m. A sum of Maxwell elements (spring k and damper
in series, corner w_i) realises it causally:

    Z = sum of k / (s + w_i),  k = (2 / pi) h ln(w_(i+1) / w_i)

Between the corners Re Z = h / omega. Causality adds a stiffness (2 / pi) h (ln(omega / w_first) +
half a step of ln w_i); so the lowest corner matters, and two are shown.

The device is weir2008 with the elements added; nothing is fitted. Trials are those of the paper,
judged on the lines of the window alone.

Limitations: a comparison of predicted limits with trials. Friction that breaks away makes predicted
limits of K about 5 to 14 % too large.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from pages.markdown import replaced, table

from examples.weir2008.paper import LEVELS, MAIN, PAPER
from examples.weir2008.run import conditions
from hapticd.core.arrays import Flags, Floats
from hapticd.model.blueprint import StateVariable
from hapticd.model.model import Model, Output, Outputs, frozen
from hapticd.signal.verdict import judge
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.limits import ORIGIN, predicted_limit
from hapticd.zwidth.sources import SATURATED, Display

PAGE = Path(__file__).parent / "reproduction.md"
PER_DECADE = 2  # elements: a ripple of 0.3 %
CORNERS_HZ = ((1.0, 1e3), (0.1, 1e4))  # first and last of the elements
LOSSES_N_PER_M = (7.5, 15.0, 30.0)
TRIED_N_PER_M = 15.0
SEEDS = (1, 2, 3, 4)
TRIED = np.linspace(0.75, 1.12, 32)  # of the predicted limit
LIMITS = tuple((level, axis) for level in LEVELS for axis in range(3))  # as in PAPER
DIGITS = (".0f", ".2f", ".2f") * 2
SHOWN = (1.0, 1.0, 1e3) * 2  # M in g
HEADINGS = (
    "h [N/m]", "elements from", "method", "K off [N/m]", "B off [N s/m]", "M off [g]",
    "K on [N/m]", "B on [N s/m]", "M on [g]", "ratios K, B, M", "worst",
)  # fmt: skip


def corners(span_hz: tuple[float, float]) -> Floats:
    """Return the corners (n,) [rad/s] of the elements, evenly in ln f."""
    count = round(np.log10(span_hz[1] / span_hz[0]) * PER_DECADE) + 1
    return np.asarray(2.0 * np.pi * np.geomspace(*span_hz, count))


def with_loss(model: Model, loss_n_per_m: float, span_hz: tuple[float, float]) -> Model:
    """Return `model` with that loss at its rotor; the force of each element is one more state."""
    corner = corners(span_hz)
    n = len(model.states)
    rotor = int(np.argmax(model.outputs.velocity.c0))
    grown = (0, corner.size)
    a0 = np.pad(model.a0, (grown, grown))
    a0[n:, rotor] = 2.0 / np.pi * loss_n_per_m * np.log(corner[1] / corner[0])
    a0[n:, n:] = -np.diag(corner)
    a0[rotor, n:] = -model.b0[rotor, model.inputs.torque]
    return replace(
        model,
        states=(*model.states, *(_force(place) for place in range(corner.size))),
        a0=frozen(a0),
        a1=frozen(np.pad(model.a1, (grown, grown))),
        b0=frozen(np.pad(model.b0, (grown, (0, 0)))),
        b1=frozen(np.pad(model.b1, (grown, (0, 0)))),
        outputs=_outputs(model.outputs, corner.size),
    )


def _force(place: int) -> StateVariable:
    return StateVariable(f"loss_{place}_force", "N", "loss")


def _outputs(outputs: Outputs, more: int) -> Outputs:
    """Return the same outputs of a model with `more` states, which no output contains."""

    def longer(row: Floats) -> Floats:
        return frozen(np.pad(row, (0, more)))

    given = {item.name: getattr(outputs, item.name) for item in fields(Outputs)}
    return Outputs(
        **{
            name: replace(one, c0=longer(one.c0), c1=longer(one.c1))
            if isinstance(one, Output)
            else one
            for name, one in given.items()
        }
    )


def predicted(device: Display) -> Floats:
    """Return the six limits (6,), in the order of PAPER."""
    return np.array([predicted_limit(device, level, axis) for level, axis in LIMITS])


def tried(device: Display, near: Floats) -> Floats:
    """Return the same by trials about `near` (6,), means over SEEDS."""
    found = [
        [_last_passed(device, level, axis, distance, seed) for seed in SEEDS]
        for (level, axis), distance in zip(LIMITS, near, strict=True)
    ]
    return np.asarray(np.mean(found, axis=1))


def _last_passed(device: Display, level: float, axis: int, near: float, seed: int) -> float:
    """Return the last value that passes before the first that fails."""
    points = np.tile(ORIGIN, (TRIED.size, 1))
    points[:, axis] = near * TRIED
    passed = _passed(device, level, points, seed)
    if passed.all() or not passed[0]:
        raise SystemExit(f"the limit of axis {axis} at {level:g} N s/m is not near {near:g}")
    return float(points[np.argmin(passed) - 1, axis])


def _passed(device: Display, level: float, points: Floats, seed: int) -> Flags:
    """Return which environments (n, 3) are passive in a trial, by the paper's rule."""
    found = simulate(
        device.model, points, conditions(MAIN).seconds, seed, active_damping=level,
        filters=device.filters, excitation=device.excitation, substeps=4, dtype="f32",
        keep="spectra",
    )  # fmt: skip
    calm = ~found.diverged & (found.max_force_n < SATURATED * device.force_limit_n)
    return np.array(
        [bool(calm[trial]) and judge(found.spectra(trial)).passes for trial in range(len(points))]
    )


def row(loss_n_per_m: float, first: str, method: str, limits: Floats) -> tuple[str, ...]:
    """Return one line of the table; each limit with its difference from the paper's."""
    off = 100.0 * (limits / np.array(list(PAPER.values())) - 1.0)
    cells = [
        f"{value * factor:{digits}} ({percent:+.0f} %)"
        for value, factor, digits, percent in zip(limits, SHOWN, DIGITS, off, strict=True)
    ]
    ratios = ", ".join(f"{ratio:.2f}" for ratio in limits[3:] / limits[:3])
    return f"{loss_n_per_m:g}", first, method, *cells, ratios, f"{abs(off).max():.0f} %"


def compared() -> list[tuple[str, ...]]:
    """Return all lines: predicted without the loss and with it, then by trials."""
    device = conditions(MAIN).display
    none = predicted(device)
    predictions = [row(0.0, "-", "predicted", none)]
    trials = [row(0.0, "-", "trials", tried(device, none))]
    for span_hz in CORNERS_HZ:
        for loss in LOSSES_N_PER_M:
            lossy = replace(device, model=with_loss(device.model, loss, span_hz))
            near = predicted(lossy)
            predictions.append(row(loss, f"{span_hz[0]:g} Hz", "predicted", near))
            if loss == TRIED_N_PER_M:
                trials.append(row(loss, f"{span_hz[0]:g} Hz", "trials", tried(lossy, near)))
    return predictions + trials


if __name__ == "__main__":
    lines = table(HEADINGS, compared())
    PAGE.write_text(replaced(PAGE.read_text(), "loss", lines))
