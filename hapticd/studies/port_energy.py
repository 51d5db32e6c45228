"""The energy that a display gives out at its port, in a family of passive hands: a measure that
also judges laws without an impedance, such as FOAW, Levant's differentiator and PO/PC.

A hand (`model.coupled.Hand`) is a mass on the probe, a spring and a damper to a second mass, and a
spring and a damper from there to the ground. All six sizes are spread evenly in their logarithms,
from less than a fingertip to more than an arm, and far beyond both in their losses. Everything is
at rest when the probe is pushed for 0.25 s and let go: with 1 N where the scene's noise is the
paper's, in proportion where it is stronger, but with no more than half of the force limit. A
passive display has then received, up to any time, at least as much energy as it has given back. The
energy given out beyond that is its own:

    E = - least over t of the integral of (push + force of the hand) v        at the port

The largest K is the largest one below the first at which some hand of the family gets more than
GIVEN_J, or the motion diverges. Hands in which that happens first are varied, to find worse ones.
This is a necessary condition of passivity, in these hands and for this push; the theorem
(`model.theorem`) is a sufficient one without dry friction.

Draws (`draws`). The result depends on the hands. At the best B of a row, a pool of POOL times as
many other hands is tried. From it, 32 draws take as many hands as the search began with, each draw
the same ones for all laws. Their largest K, without variation, show the scatter between draws.

The port is recorded at 4 kHz, as means of force and velocity: energy above about 500 Hz is booked
too small. Limitations: hands of more than two masses, other pushes, and growth so
slow that it does not show within SECONDS.

Felt impedance (`felt`). The probe plays one sine after the other, each of SINE times the push. Z is
the ratio of the Fourier sums of force and velocity over the last second: the describing function at
this force. Encoder and force limit act, dry friction does not, as in the column of the linear
remedies. On a linear law both agree.

Noise at rest (`noise_at_rest`). The law plays in CPython (`played`), with the loop open: the handle
rests, and the positions are white, evenly distributed over a count of the encoder. Their rms is
that of rounding, quantum / sqrt(12), as in the column of the linear remedies. All of the first
TICKS count: some laws give one large force and are quiet afterwards.

Limitations of both: other forces, at which a nonlinear law has another impedance; Z at harmonics of
the sine.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf, isfinite, nan, pi, sqrt
from typing import Any

import numpy as np

from hapticd import __version__
from hapticd.core.arrays import Complexes, Floats
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.model.coupled import Hand, at_port
from hapticd.model.scene import Scene
from hapticd.render.law import at_rest, design_coefficients, render
from hapticd.studies.remedies import REMEDIES, RENDERED_HZ, RemediesParams, Row, treated
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.parts import CONTROLLERS, ESTIMATORS, WINDOW, LawPart
from hapticd.zwidth.sources import NOISE, SUBSTEPS, display
from hapticd.zwidth.store import Progress, Steps, TrialStore, fingerprint, silent, to_json

__all__ = ["SECONDS", "run_port_energy"]

SECONDS = 2.0  # of a trial
PUSH_N = 1.0  # under the noise of the paper
PUSH_S = 0.25
GIVEN_J = 1e-5  # beyond rounding and the error of the record
# sizes of a hand: mass on the probe [kg], second mass, spring [N/m] and damper [N s/m] between
# the two, spring and damper to the ground
LEAST = np.log([1e-5, 1e-4, 10.0, 1e-3, 1.0, 1e-3])
MOST = np.log([1.0, 3.0, 1e5, 100.0, 1e5, 100.0])
HANDS = (24, 6)  # drawn; with --quick
CHILDREN = (12, 4)  # of the worst hands, in each round
ROUNDS = (2, 1)
PARENTS = 4
HOPEFUL = 4  # values of B that are searched further
VARIED = 0.5  # sd of a logarithm
STIFFNESS = np.geomspace(0.25, 32.0, 12)  # over the first row's by the theorem
VIRTUAL_DAMPING = np.array([0.0, *np.geomspace(0.5, 128.0, 9)])  # over the first row's
LEAST_DAMPING = 0.05  # of K T, where the first row's best B is less
FINER = np.geomspace(0.5, 1.1, 32)  # over the K to be improved
DRAWS = 32
POOL = 4  # hands of the pool over those of a draw
AROUND = np.geomspace(0.2, 3.0, 32)  # over the K of the search, of the pool
ACCELERATIONS = np.array([1.0, 0.25, 4.0])  # C of Levant over that of the push
LEVELS = np.array([1.0, 0.1, 10.0])  # of a tank over the energy of the push in the first row's K
FOAW = "FOAW"
OBSERVERS = {
    "PO/PC": LawPart.observer(),
    "PO/PC, held force": LawPart.held_observer(),
    "PO/PC, window": LawPart.observer(WINDOW),
}
TANK = {"tank": LEVELS[:1], "tank, best level": LEVELS}
LEVANT = {"Levant": ACCELERATIONS[:1], "Levant, best C": ACCELERATIONS}
AS_IT_IS = REMEDIES[0].name
DAMPED = "1.74 N s/m"
PAIRS = {f"{name}, {DAMPED}": name for name in (FOAW, "PO/PC", "tank")}  # with active damping
# each judged remedy, and the remedy of the table by theory that it extends
BASES = {
    **{name: name for name in (AS_IT_IS, "best corner", DAMPED)},
    **dict.fromkeys((FOAW, *LEVANT, *OBSERVERS, *TANK), AS_IT_IS),
    **dict.fromkeys(PAIRS, DAMPED),
}
ASKED = 2.0  # of `EnergyRow.given_out_j`, over the first row's K
Parts = tuple[LawPart, ...]


@dataclass(frozen=True, eq=False)
class EnergyRow:
    """A device with a remedy. nan: there is no such number."""

    device: str  # name of the scene
    remedy: str
    number: float  # count [m] of FOAW, C [m/s^2] of Levant, level [J] of a tank; nan
    virtual_damping_ns_per_m: float  # of those tried, the B that lets K go farthest
    stiffness_n_per_m: float  # largest K in every hand, of search and draws; nan: none
    asked_n_per_m: float  # K of what follows, at the same B
    diverged: bool  # there, in some hand
    given_out_j: float  # there, in the worst hand, within SECONDS
    draws_n_per_m: Floats  # (DRAWS,) largest K in the hands of each draw, at the same B
    rendered: Complexes  # (3,) at RENDERED_HZ, Z over what the first row is asked for
    noise_n: float  # rms at rest, of the same environment


@dataclass(frozen=True, eq=False)
class Tried:
    """A device with a law, and its first K to fail [N/m] in each hand at the most hopeful B."""

    scene: Scene
    parts: Parts
    virtual_damping_ns_per_m: Floats  # (B,)
    hands: Floats  # (H, 6) logarithms of sizes
    failed_n_per_m: Floats  # (H, B); inf: none
    most_n_per_m: float  # that was tried

    @property
    def limit_n_per_m(self) -> float:
        """The first K to fail in any hand at the best B, or the largest one tried."""
        return min(float(self.failed_n_per_m.min(axis=0).max()), self.most_n_per_m)

    @property
    def best(self) -> int:
        """The place of the best B."""
        return int(np.argmax(self.failed_n_per_m.min(axis=0)))


def hand_of(sizes: Floats) -> Hand:
    """Return the hand of six logarithms."""
    probe, mass, grip_k, grip_b, arm_k, arm_b = np.exp(sizes)
    between = np.array([[1.0, -1.0], [-1.0, 1.0]])
    ground = np.diag([0.0, 1.0])
    damping = grip_b * between + arm_b * ground
    return Hand(np.array([probe, mass]), damping, grip_k * between + arm_k * ground)


def pushed_n(scene: Scene) -> float:
    """Return the push [N] on the scene's device."""
    stronger = sqrt(scene.noise.psd_n2_per_hz / NOISE.psd_n2_per_hz)
    return min(PUSH_N * stronger, 0.5 * display(scene).force_limit_n)


def given_out(scene: Scene, parts: Parts, hands: Floats, points: Floats) -> Floats:
    """Return E [J] (H, N) of environments (N, 2), K and B, in `hands` (H, 6); inf if diverged."""
    model = display(scene).model
    seconds = np.arange(round(SECONDS * PROBE_RATE_HZ)) / PROBE_RATE_HZ
    found = np.zeros((len(hands), len(points)))
    for row, sizes in zip(found, hands, strict=True):
        trials = simulate(
            at_port(model, hand_of(sizes)),
            np.pad(points, ((0, 0), (0, 1))),
            SECONDS,
            active_damping=scene.level_ns_per_m,
            environment=scene.free_of_walls,
            excitation=np.where(seconds < PUSH_S, pushed_n(scene), 0.0),
            substeps=SUBSTEPS,
            parts=parts,
        )
        row[:] = np.where(trials.diverged, inf, np.maximum(-trials.min_energy_j, 0.0))
    return found


def first_failures(scene: Scene, parts: Parts, hands: Floats, k: Floats, b: Floats) -> Floats:
    """Return the first of `k` [N/m] (ascending) at which each hand gets too much, at each of `b`
    [N s/m]: (H, B); inf: none.
    """
    points = np.array([(stiffness, damping) for damping in b for stiffness in k])
    fails = given_out(scene, parts, hands, points).reshape(len(hands), b.size, k.size) > GIVEN_J
    return np.where(fails.any(axis=-1), k[np.argmax(fails, axis=-1)], inf)


def drawn(seed: int, count: int) -> Floats:
    """Return so many hands (count, 6) of the family."""
    return np.random.default_rng(seed).uniform(LEAST, MOST, (count, LEAST.size))


@lru_cache(maxsize=len(LEVELS))  # the row before may have tried the same number
def tried(scene: Scene, parts: Parts, first: Row, quick: bool) -> Tried:
    """Try the coarse grid over the first row's K and B, in the hands that all laws share."""
    hands = drawn(1, HANDS[quick])
    least = LEAST_DAMPING * first.stiffness_n_per_m / first.rate_hz
    b = VIRTUAL_DAMPING * max(first.virtual_damping_ns_per_m, least)
    k = STIFFNESS * first.stiffness_n_per_m
    failed = first_failures(scene, parts, hands, k, b)
    # many fail at the same K of a coarse grid: then the one with which more hands get farther
    hopeful = np.lexsort((-np.minimum(failed, k[-1]).mean(axis=0), -failed.min(axis=0)))[:HOPEFUL]
    return Tried(scene, parts, b[hopeful], hands, failed[:, hopeful], float(k[-1]))


@lru_cache(maxsize=len(LEVELS))
def worsened(one: Tried, quick: bool) -> Tried:
    """Add variations of the hands that fail first, on finer grids of K below their failure."""
    random = np.random.default_rng(2)
    for _ in range(ROUNDS[quick]):
        worst = np.argsort(one.failed_n_per_m[:, one.best], kind="stable")[:PARENTS]
        places = worst[random.integers(PARENTS, size=CHILDREN[quick])]
        varied = one.hands[places] + VARIED * random.standard_normal((places.size, LEAST.size))
        hands = np.concatenate((one.hands[worst], np.clip(varied, LEAST, MOST)))
        k = FINER * one.limit_n_per_m
        failed = first_failures(one.scene, one.parts, hands, k, one.virtual_damping_ns_per_m)
        before = one.failed_n_per_m.copy()
        before[worst] = failed[:PARENTS]
        one = replace(
            one,
            hands=np.concatenate((one.hands, hands[PARENTS:])),
            failed_n_per_m=np.concatenate((before, failed[PARENTS:])),
        )
    return one


def draws(one: Tried, quick: bool) -> tuple[Floats, float]:
    """Return the largest K [N/m] of those tried in the hands of each draw (DRAWS,), and the first
    to fail in any hand of the pool on a finer grid; at the best B. 0: all of them fail.
    """
    hands = drawn(3, POOL * HANDS[quick])
    b = one.virtual_damping_ns_per_m[[one.best]]
    k = AROUND * one.limit_n_per_m
    failed = first_failures(one.scene, one.parts, hands, k, b)[:, 0]
    random = np.random.default_rng(4)
    taken = [random.choice(failed, HANDS[quick], replace=False).min() for _ in range(DRAWS)]
    before = np.concatenate(([0.0], k))[np.searchsorted(k, taken)]
    finer = FINER * min(failed.min(), one.limit_n_per_m)
    worst = hands[np.argsort(failed, kind="stable")[:PARENTS]]
    first = first_failures(one.scene, one.parts, worst, finer, b).min()
    return before, 0.0 if first == finer[0] else float(first)


# --- a table --------------------------------------------------------------------------------------


def laws(name: str, scene: Scene, first: Row) -> list[tuple[float, Parts]]:
    """Return the parts that a remedy may add to the law, each with its number; the best counts."""
    model = display(scene).model
    if name == FOAW:
        count_m = model.encoder_quantum_m or 0.0
        return [(count_m, (LawPart.foaw(count_m, model.rate_hz),))]
    if name in LEVANT:
        pushed = LEVANT[name] * pushed_n(scene) / model.mass_kg
        return [(float(c), (LawPart.levant(float(c), model.rate_hz),)) for c in pushed]
    if name in TANK:
        levels = TANK[name] * pushed_n(scene) ** 2 / (2.0 * first.stiffness_n_per_m)
        refill = 0.5 * first.stiffness_n_per_m / model.rate_hz  # pays for K without delay
        return [(float(one), (LawPart.tank(float(one), refill, model.rate_hz),)) for one in levels]
    return [(nan, (OBSERVERS[name],) if name in OBSERVERS else ())]


def judged(name: str, scene: Scene, first: Row, quick: bool) -> EnergyRow:
    """Return the row of a remedy whose scene is `scene`."""
    found = [
        (number, worsened(tried(scene, parts, first, quick), quick))
        for number, parts in laws(PAIRS.get(name, name), scene, first)
    ]
    number, best = max(found, key=lambda one: one[1].limit_n_per_m)
    b = float(best.virtual_damping_ns_per_m[best.best])
    by_draws, fails = draws(best, quick)
    # the one before the first to fail
    limit = min(best.limit_n_per_m, fails) * float(FINER[0] / FINER[1])
    asked = ASKED * first.stiffness_n_per_m
    given = float(given_out(scene, best.parts, best.hands, np.array([[asked, b]])).max())
    return EnergyRow(
        device=first.device,
        remedy=name,
        number=number,
        virtual_damping_ns_per_m=b,
        stiffness_n_per_m=limit if limit > STIFFNESS[0] * first.stiffness_n_per_m else nan,
        asked_n_per_m=asked,
        diverged=given == inf,
        given_out_j=nan if given == inf else given,
        draws_n_per_m=by_draws,
        rendered=felt(scene, best.parts, first.asked, SINE * pushed_n(scene)),
        noise_n=noise_at_rest(scene, best.parts, first.asked),
    )


def run_port_energy(
    params: RemediesParams, rows: Sequence[Row], store: TrialStore, tell: Progress = silent
) -> tuple[EnergyRow, ...]:
    """Judge the linear remedies in `rows` and the nonlinear ones, for each device that renders some
    K. Rows in the store are not computed again. ConfigError as `compose` and `simulate`.
    """
    known = {(row.device, row.remedy): row for row in rows}
    asked = [
        (name, scene, known[scene.name, AS_IT_IS], known[scene.name, base])
        for scene in params.scenes
        for name, base in BASES.items()
        if (scene.name, base) in known and isfinite(known[scene.name, AS_IT_IS].stiffness_n_per_m)
    ]
    steps = Steps(tell, len(asked))
    found = []
    for name, scene, first, base in asked:
        steps.next(f"{scene.name}, {name}: energy at the port")
        own = treated(
            scene,
            next(one for one in params.remedies if one.name == base.remedy),
            base.corner_hz,
        )
        best = first.stiffness_n_per_m, first.virtual_damping_ns_per_m
        key = fingerprint((__version__, "energy at the port", name, own, best, params.quick))
        if key not in store.known:
            store.add([(key, to_json(judged(name, own, first, params.quick)))])
        found.append(_row(store.known[key]))
    steps.end()
    return tuple(found)


def _row(kept: Mapping[str, Any]) -> EnergyRow:
    """Return a row of the store, where null is nan and a complex number a pair."""
    arrays = {
        "draws_n_per_m": np.array(kept["draws_n_per_m"]),
        "rendered": np.array(kept["rendered"], np.float64) @ [1.0, 1j],
    }
    row: dict[str, Any] = {name: nan if value is None else value for name, value in kept.items()}
    return EnergyRow(**row | arrays)


# --- what a hand feels, and the noise at rest -----------------------------------------------------

SINE = 0.1  # amplitude of the probe's force over the push
SETTLED_S = 4.0  # length of a trial; its last second counts
TICKS = 4000  # of the noise at rest
NO_WALL = (0.0, 0.0, 0.0, 0.0, -inf, inf, 0.0)


def felt(
    scene: Scene, parts: tuple[LawPart, ...], asked: tuple[float, float], amplitude_n: float
) -> Complexes:
    """Return Z at RENDERED_HZ (3,) over the asked K / s + B, `asked` in N/m and N s/m, for sines of
    that amplitude; nan where the motion diverges.
    """
    calm = scene.without("coulomb")
    second = np.arange(PROBE_RATE_HZ) / PROBE_RATE_HZ
    found = []
    for hz in RENDERED_HZ:
        trial = simulate(
            display(calm).model,
            [[*asked, 0.0]],
            SETTLED_S,
            active_damping=calm.level_ns_per_m,
            environment=calm.free_of_walls,
            excitation=amplitude_n * np.sin(2.0 * pi * hz * second),
            substeps=SUBSTEPS,
            keep="records",
            parts=parts,
        )
        force, velocity = (one[-second.size :] for one in trial.record(0))
        turn = np.exp(-2j * pi * hz * second)
        z = nan if trial.diverged[0] else (force @ turn) / (velocity @ turn)
        found.append(z / (asked[0] / (2j * pi * hz) + asked[1]))
    return np.array(found)


def played(
    scene: Scene, parts: tuple[LawPart, ...], asked: tuple[float, float], positions_m: Floats
) -> Floats:
    """Return the forces [N] (N,) of the law with `parts` in CPython, tick by tick, for `asked` K
    [N/m] and B [N s/m], from rest at 0.
    """
    k, b = asked
    shown = display(scene)
    coefficients = design_coefficients(*scene.environment.filters, shown.model.rate_hz)
    state = at_rest(0.0)
    memories: list[Any] = [part.at_rest(0.0) for part in parts]
    limit = shown.force_limit_n
    forces = []
    for x in positions_m.tolist():
        inputs = (k, b, 0.0, 0.0, limit, *NO_WALL)
        for place, part in enumerate(parts):
            if part.kind in ESTIMATORS:
                v, memories[place] = ESTIMATORS[part.kind](x, memories[place], part.numbers)
                inputs = (k, 0.0, 0.0, -b * v, limit, *NO_WALL)
        force, *_, state = render(x, state, inputs, coefficients)
        for place, part in enumerate(parts):
            if part.kind in CONTROLLERS:
                force, memories[place] = CONTROLLERS[part.kind](
                    x, force, limit, memories[place], part.numbers
                )
        forces.append(force)
    return np.array(forces)


def noise_at_rest(scene: Scene, parts: tuple[LawPart, ...], asked: tuple[float, float]) -> float:
    """Return the rms force [N] of the law at rest; nan without an encoder."""
    quantum_m = display(scene).model.encoder_quantum_m
    if quantum_m is None:
        return nan
    positions = quantum_m * (np.random.default_rng(1).random(TICKS) - 0.5)
    return float(np.sqrt(np.mean(played(scene, parts, asked, positions) ** 2)))
