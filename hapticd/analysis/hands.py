"""Hands: passive one-ports at the probe, as networks of masses, dampers and springs.

    M x'' + D x' + K x = f,   node 0 is the probe,
    Z_h = S(s) / s with S the stiffness seen at node 0, the others free

M, D and K have no negative eigenvalue (masses are on the nodes; a damper or spring adds a square of
one difference). For every s with Re s > 0 that alone makes Re Z_h(s) >= 0, so all of them are
positive real: passive by construction (Brune 1931), from a fingertip to a tree of resonators
without any loss. A node may be without a mass where a damper holds it, as in a Maxwell arm.

`held_by` grips the rotor of a composed device: exact, so that its sampled loop can be asked for its
eigenvalues.

What would break it: a node that only dampers hold. It stays where it is pushed to, an eigenvalue 1
that is no oscillation.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hapticd.analysis.arrays import Complexes, Flags, Floats, Integers
from hapticd.errors import AnalysisError
from hapticd.plant.blueprint import StateVariable
from hapticd.plant.model import Model, Output, Outputs

GROUND = -1
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Hand:
    """`mass_kg` (n,), `damping_ns_per_m` (n, n), `stiffness_n_per_m` (n, n), float64; node 0 is the
    probe.

    AnalysisError unless they are symmetric without negative eigenvalue, and every other node has a
    mass or a damper.
    """

    mass_kg: Floats
    damping_ns_per_m: Floats
    stiffness_n_per_m: Floats

    def __post_init__(self) -> None:
        """Passive, or refused."""
        for name, matrix in (
            ("mass", np.diag(self.mass_kg)),
            ("damping", self.damping_ns_per_m),
            ("stiffness", self.stiffness_n_per_m),
        ):
            least = float(np.linalg.eigvalsh(matrix)[0])
            size = float(np.abs(matrix).max())
            if not np.allclose(matrix, matrix.T) or least < -_ROUNDING * size:
                raise AnalysisError(
                    f"a hand whose {name} matrix has the eigenvalue {least:.3g} is not passive; it"
                    " takes symmetric, >= 0"
                )
        if np.any(self.loose & (np.diag(self.damping_ns_per_m) <= 0.0)):
            raise AnalysisError(
                "a node of a hand without mass and without damper; give it one of them, or leave"
                " it out"
            )

    @property
    def loose(self) -> Flags:
        """(n,) nodes without a mass, other than the probe."""
        return np.asarray((self.mass_kg == 0.0) & (np.arange(self.mass_kg.size) > 0))

    def impedance(self, s: Complexes) -> Complexes:
        """Z_h(s) (F,) [N s/m] at complex frequencies s (F,) [rad/s] that are not its poles."""
        x = s[:, None, None]
        all_nodes = (
            x * x * np.diag(self.mass_kg) + x * self.damping_ns_per_m + self.stiffness_n_per_m
        )
        inner = np.linalg.solve(all_nodes[:, 1:, 1:], all_nodes[:, 1:, :1])
        return np.asarray((all_nodes[:, 0, 0] - (all_nodes[:, :1, 1:] @ inner)[:, 0, 0]) / s)


class Network:
    """A hand under construction: nodes and what joins them; `GROUND` is the wall."""

    def __init__(self, mass_kg: float = 0.0) -> None:
        self._masses, self._joints = [mass_kg], list[tuple[int, int, float, float]]()

    def node(self, mass_kg: float = 0.0) -> int:
        """Another node."""
        self._masses.append(mass_kg)
        return len(self._masses) - 1

    def join(
        self, one: int, other: int, stiffness_n_per_m: float = 0.0, damping_ns_per_m: float = 0.0
    ) -> None:
        """A spring and a damper side by side between two nodes."""
        self._joints.append((one, other, stiffness_n_per_m, damping_ns_per_m))

    def hand(self) -> Hand:
        """What was built. AnalysisError as `Hand`."""
        size = len(self._masses)
        stiffness, damping = np.zeros((2, size, size))
        for one, other, spring, damper in self._joints:
            across = np.zeros(size)
            across[[node for node in (one, other) if node != GROUND]] = (1.0, -1.0)[
                : 2 - (one, other).count(GROUND)
            ]
            stiffness += spring * np.outer(across, across)
            damping += damper * np.outer(across, across)
        return Hand(np.array(self._masses), damping, stiffness)


def held_by(model: Model, hand: Hand) -> Model:
    """`model` with `hand` on its rotor, where the probe is. Its winding stays as warm as it is."""
    rotor = int(np.argmax(model.outputs.velocity.c0))
    place = int(np.argmax(model.outputs.position.c0))
    n = len(model.states)
    inner = np.arange(1, hand.mass_kg.size)
    heavy = np.flatnonzero(hand.mass_kg[1:]) + 1
    size = n + inner.size + heavy.size
    unit = np.eye(size)
    position = np.vstack((unit[place], unit[n : n + inner.size]))
    velocity = np.zeros((hand.mass_kg.size, size))
    velocity[0], velocity[heavy] = unit[rotor], unit[n + inner.size :]
    loose = hand.loose
    push = hand.damping_ns_per_m @ velocity + hand.stiffness_n_per_m @ position
    velocity[loose] = -np.linalg.solve(hand.damping_ns_per_m[np.ix_(loose, loose)], push[loose])
    force = hand.damping_ns_per_m @ velocity + hand.stiffness_n_per_m @ position
    ease = float(model.b0[rotor, model.inputs.torque])  # 1/kg
    share = 1.0 / (1.0 + ease * hand.mass_kg[0])
    a0 = _wider(model.a0, size, size, rotor, share)
    a0[rotor] -= share * ease * force[0]
    a0[n:] = np.vstack((velocity[1:], -force[heavy] / hand.mass_kg[heavy, None]))
    width = model.inputs.width
    return replace(
        model,
        states=(*model.states, *_names(inner, "position", "m"), *_names(heavy, "velocity", "m/s")),
        a0=a0,
        a1=_wider(model.a1, size, size, rotor, share),
        b0=_wider(model.b0, size, width, rotor, share),
        b1=_wider(model.b1, size, width, rotor, share),
        outputs=_seen(model.outputs, size),
        winding=None,
    )


def _wider(matrix: Floats, rows: int, columns: int, rotor: int, share: float) -> Floats:
    """`matrix` of the device among zeros, its rotor heavier."""
    found = np.zeros((rows, columns))
    found[: len(matrix), : matrix.shape[1]] = matrix
    found[rotor] *= share
    return found


def _seen(outputs: Outputs, size: int) -> Outputs:
    def wider(one: Output | None) -> Output | None:
        return one and replace(
            one,
            c0=np.pad(one.c0, (0, size - one.c0.size)),
            c1=np.pad(one.c1, (0, size - one.c1.size)),
        )

    changed: dict[str, Any] = {
        part.name: wider(getattr(outputs, part.name)) for part in fields(outputs)
    }
    return replace(outputs, **changed)


def _names(nodes: Integers, what: str, unit: str) -> list[StateVariable]:
    return [StateVariable(f"hand_{node}_{what}", unit, "hand") for node in nodes]
