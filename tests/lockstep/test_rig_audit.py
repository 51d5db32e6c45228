"""`rig audit` and `rig trim` while a hand moves the handle: what is delivered, and what is left of
the winding, against the closed form alpha = 1 / (1 + g dR / K^2).
"""

from math import pi, sin

from support.rig_hand import Hand

from hapticd.core.params import ScaleParams
from hapticd.core.units import COPPER_PER_K
from hapticd.model.compose import board_fields, compose_device
from hapticd.model.effects import (
    Amplifier,
    Coulomb,
    DampingCircuit,
    Masses,
    Motor,
    Viscous,
    WindingHeating,
    WindingTemperature,
)
from hapticd.protocol.view import as_records
from hapticd.rig.steps.delivery import measure_delivery, measure_residual

N_PER_A = 1.65
OHM = 1.6
GRIP_N_PER_M = 300.0
MOVED_M = 5e-3
MOVED_HZ = 2.7
FILE = {"motor_n_per_a": N_PER_A, "emf_velocity": ScaleParams(2.0 / 32767)}


def board(residual_ohm, **more):
    """A board whose winding has so much more than its circuit believes."""
    colder_k = residual_ohm / (OHM * COPPER_PER_K)
    effects = (
        Masses(rotor_kg=0.007),
        Viscous(rotor_ns_per_m=0.3),
        Coulomb(rotor_n=0.04),
        Amplifier(bandwidth_hz=5000.0),
        DampingCircuit(bandwidth_hz=1000.0),
        Motor(torque_constant_nm_per_a=N_PER_A, lever_m=1.0, resistance_ohm=OHM),
        WindingTemperature(temperature_c=20.0, compensated_c=20.0 - colder_k),
        WindingHeating(thermal_resistance_k_per_w=0.0, time_constant_s=10.0, ambient_c=20.0),
    )
    return board_fields(compose_device("made", effects, 1000.0), (), 12.0, 0.8) | more


class Moving(Hand):
    """A hand that moves the handle from when it is asked to."""

    moves = False

    @property
    def pull_n(self):
        wanted_m = MOVED_M * sin(2.0 * pi * MOVED_HZ * self.axis.now / 16000.0)
        return GRIP_N_PER_M * (wanted_m - self.position_m) if self.moves else 0.0

    @pull_n.setter
    def pull_n(self, force_n):
        pass

    def ask(self, request):
        assert request.action == "shake"
        self.moves = True


def test_audit_needs_the_force_of_an_ampere():
    with Moving(FILE | {"motor_n_per_a": 0.0}, **board(0.0)) as hand:
        result = measure_delivery(hand.bench, hand.ask, 5.0)
        assert not as_records(hand.bench.run(10))["force_n"].any()
    assert result.findings[0].verdict == "not done"


def test_trim_takes_the_resistance_dac_of_the_board():
    with Moving(FILE, **board(0.0)) as hand:
        result = measure_residual(hand.bench, hand.ask)
    assert result.findings[0].verdict == "not done"
    assert "resistance DAC" in result.findings[0].what
