"""Blind rigs: a simulated device with parameters from a seed, which steps access through a client.

    with BlindRig(7) as rig:                # or BlindRig(7, "stuck encoder", coulomb_n=0.5)
        rig.bench                           a LockStepClient, the Client that steps get
        rig.ask                             the person who fulfils a `rig.result.Request`
        rig.device_file                     template with the board's nominal scales, in a folder
        rig.write(result)                   stores and writes the results of a step, as the verbs do
        rig.restart()                       a new daemon of the written file; the device stays
        rig.true("moving mass", "identify") the true value of a quantity, in the unit of its Value
        rig.worst_share                     motor's force over the limit until signs were verified

`first_day(rig)` runs the existing steps in the order of the guided path, and returns the results.
Names in `true` are names of a `Value`; an unknown one is None.

A step never accesses the true parameters (`blind_truth`) or the person (`blind_hand`).
"""

import datetime
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from math import atan, pi, sin
from pathlib import Path
from typing import Any
from unittest.mock import patch

import tomlkit

from hapticd.core.errors import HapticdError
from hapticd.core.units import COPPER_PER_K
from hapticd.model.params import BoardParams
from hapticd.rig import certificate
from hapticd.rig.certificate import keep
from hapticd.rig.result import Finding, StepResult, Value
from hapticd.rig.steps import damping, encoder, identify, link, motor, probe, verify, winding
from hapticd.rig.steps.probe_fits import ReferenceSpring
from hapticd.run import lockstep
from hapticd.run.lockstep import LockStepClient
from hapticd.settings.build import commissioning, servo_params
from hapticd.settings.load import Settings, load
from hapticd.usb.codec import I16_HIGHEST, U16_HIGHEST
from support.blind_hand import Person
from support.blind_truth import NOMINAL, SERIAL, BlindBoard, Truth, drawn
from support.tree import ROOT

TEMPLATE = ROOT / "config/devices/example-board.toml"
DAY = datetime.date(2026, 11, 22)
LIMIT_N = 8.0
MASSES_KG = (0.0, 0.025, 0.05, 0.075, 0.1)
DISTANCE_M = 0.01
FIXED_KG = 0.02
EDITS: dict[str, dict[str, Any]] = {  # edits of the owner in the template, by table
    "": {"name": "blind", "serial": SERIAL},
    "limits": {"force_n": LIMIT_N, "active_damping_ns_per_m": 10.0},
    "home": {"method": "none", "required": False},
}
CONFIG = 'device = "blind"\n[realtime]\nmode = "off"\n'

# the step that refuses a broken rig, and a word of its message
REFUSED = {
    "stuck encoder": ("encoder", "stuck"),
    "no authority": ("motor", "authority"),
    "slipping lever": ("motor", "slip"),
    "mass typed ten times wrong": ("motor", "typed wrong"),
    "damping polarity": ("damping", "polarity"),
    "dead probe channel": ("probe", "dead probe channel"),
    "probe channels swapped": ("probe", "channels swapped"),
}


class BlindRig:
    """One rig, as described above. Use as a context manager."""

    bench: LockStepClient

    def __init__(self, seed: int, broken: str | None = None, **changes: float) -> None:
        self.truth = replace(drawn(seed), **changes)
        self._folder = tempfile.TemporaryDirectory(prefix="hapticd-blind-")
        self.config_file = Path(self._folder.name) / "hapticd.toml"
        self.device_file = Path(self._folder.name) / "devices" / "blind.toml"
        self._lay_out()
        moving_kg = self.truth.mass_kg
        self.person = Person(seed, moving_kg, self.pass_time, lambda kg: self.board.attach(kg))
        self.person.one_signal = lambda seconds: self.board.one_signal(seconds)
        self.person.mass_error = self.truth.mass_error
        self.person.distance_error_m = self.truth.distance_error_m
        self.person.typed_wrong = broken == "mass typed ten times wrong"
        self.board = BlindBoard(self.truth, broken, self.person.pull_n)
        self._start()

    def _lay_out(self) -> None:
        document = tomlkit.parse(TEMPLATE.read_text(encoding="utf-8"))
        for table, values in EDITS.items():
            (document[table] if table else document).update(values)
        self.device_file.parent.mkdir()
        self.device_file.write_text(tomlkit.dumps(document), encoding="utf-8")
        self.config_file.write_text(CONFIG, encoding="utf-8")

    def _start(self) -> None:
        servo = servo_params(self.settings, "blind")
        with patch.object(lockstep, "simulated_backend", self.board.backend):
            self.bench = LockStepClient(servo, BoardParams(**NOMINAL))

    def __enter__(self) -> "BlindRig":
        return self

    def __exit__(self, *_: object) -> None:
        self.bench.close()
        self._folder.cleanup()

    @property
    def settings(self) -> Settings:
        """Configuration and device file, as a daemon reads them when it starts."""
        return load(self.config_file)

    @property
    def ask(self) -> Callable[..., None]:
        """The function by which steps send requests to a person."""
        return self.person.ask

    @property
    def worst_share(self) -> float:
        """Largest force of the motor before signs were verified, over the device's limit."""
        return self.board.worst_n / LIMIT_N

    def pass_time(self, seconds: float) -> None:
        """The rig runs on."""
        self.bench.run(round(seconds * NOMINAL["rate_hz"]))

    def write(self, result: StepResult) -> None:
        """Store the records of a step; write its results unless it was refused."""
        kept = keep(self.device_file, result.step, DAY, result.arrays)
        if result.settled and result.changes:
            words = "; ".join(str(value) for value in result.values)
            certificate.write_changes(
                self.device_file,
                result.changes,
                f"rig {result.step}",
                DAY,
                f"{words or 'signs seen'}; {kept}",
            )

    def restart(self) -> None:
        """A new daemon reads the device file; the device on the table stays as it is."""
        self.bench.close()
        self.board.watched &= commissioning(self.settings.device)
        self._start()

    def true(self, name: str, step: str = "") -> float | None:
        """Return the true value of the quantity `name` of `step`, in the unit of its Value; None if
        unknown. Steps that use one name for different quantities have their own entries.
        """
        quantities = known(self.truth)
        if motor_table := self.settings.device.motor:
            warmer_k = motor_table.reference_c - NOMINAL["ambient_c"]
            quantities["motor.winding_ohm"] *= 1.0 + COPPER_PER_K * warmer_k
        return quantities.get(f"{step} {name}", quantities.get(name))


def known(truth: Truth) -> dict[str, float]:
    """Every quantity that steps may find, by the name of its Value."""
    position_m = truth.position_gain * NOMINAL["position_m_per_count"]
    force_n = truth.force_gain * NOMINAL["force_n_per_count"]
    damping = truth.active_damping_gain * NOMINAL["active_damping_ns_per_m_per_count"]
    return {
        "delay": truth.delay_periods * 1e6 / NOMINAL["rate_hz"],
        "clock drift": 0.0,
        "position.m_per_count": position_m,
        "force.full_scale_n": force_n * I16_HIGHEST,
        "force.offset_count": truth.force_offset_count,
        "active_damping.full_scale_ns_per_m": damping * U16_HIGHEST,
        "damping friction seen": truth.coulomb_n,
        "motor.force_n_per_a": truth.motor_n_per_a,
        "motor.winding_ohm": NOMINAL["winding_ohm"],
        "back-EMF": truth.motor_n_per_a,
        "physical damping": truth.viscous_ns_per_m,
        "force per ampere": truth.motor_n_per_a,
        "residual resistance": truth.residual_ohm,
        **_known_of_probe(truth),
        **_known_of_model(truth),
    }


def _known_of_model(truth: Truth) -> dict[str, float]:
    # the amplifier's lag is too short to be distinguished from delay
    period_us = 1e6 / NOMINAL["rate_hz"]
    amplifier_us = 1e6 / (2.0 * pi * truth.amplifier_hz)
    smoothing_us = 1e6 / (2.0 * pi * truth.smoothing_hz)
    delay_us = truth.delay_periods * period_us + amplifier_us
    return {
        "moving mass": truth.mass_kg,
        "viscous friction": truth.viscous_ns_per_m,
        "Coulomb friction": truth.coulomb_n,
        "lag": delay_us + smoothing_us,
        "identify delay": delay_us,
        "smoothing": smoothing_us,
        "first resonance": truth.resonance_hz,
        "sliding mass": truth.slider_kg,
    }


def _known_of_probe(truth: Truth) -> dict[str, float]:
    # without the velocity channel's noise: the skew correction rounds its remainder twice
    judged = ReferenceSpring()
    corners_hz = (truth.velocity_highpass_hz, truth.torque_highpass_hz)
    of_velocity, of_torque = (atan(one / judged.lowest_hz) for one in corners_hz)
    per_radian = judged.stiffness_n_per_m / (2.0 * pi * judged.lowest_hz)
    return {
        "probe_torque.full_scale_n": truth.probe_torque_gain * 2.0,
        "probe_velocity.full_scale_m_per_s": truth.probe_velocity_gain * 2.0,
        "probe_torque.offset_count": truth.probe_torque_offset_count,
        "probe_velocity.offset_count": truth.probe_velocity_offset_count,
        "emf_velocity.full_scale_m_per_s": truth.emf_gain * 2.0,
        "emf_velocity.offset_count": 0.0,
        "temperature.offset_count": 0.0,
        "probe_torque noise": 0.0,
        "probe skew": -truth.skew_us,  # the velocity is the earlier one
        "high-pass mismatch": -per_radian * sin(of_velocity - of_torque),
    }


@dataclass
class Day:
    """The result of a first day: that of every step, and the step that could not run, with the
    reason.
    """

    results: list[StepResult] = field(default_factory=list)
    error: str = ""

    @property
    def refused(self) -> tuple[str, Finding] | None:
        """The step and the finding that ended the day."""
        for result in self.results:
            for finding in result.findings:
                if finding.verdict == "refused":
                    return result.step, finding
        return None

    @property
    def values(self) -> Iterator[Value]:
        """Everything that was measured."""
        for result in self.results:
            yield from result.values


STEPS: dict[str, Callable[[BlindRig], StepResult]] = {
    "link": lambda rig: link.measure(rig.bench),
    "encoder": lambda rig: encoder.measure(rig.bench, rig.ask, encoder.Distance(DISTANCE_M)),
    "motor sign": lambda rig: motor.measure_sign(rig.bench, rig.ask),
    "motor gain": lambda rig: motor.measure_gain(rig.bench, rig.ask, motor.Masses(MASSES_KG)),
    "winding": lambda rig: winding.measure(rig.bench, rig.ask),
    "damping": lambda rig: damping.measure(rig.bench, rig.ask),
    "probe": lambda rig: probe.measure(rig.bench, rig.ask, probe.AttachedMass(FIXED_KG)),
    "temperature": lambda rig: winding.measure_temperature(
        rig.bench, rig.ask, winding.KnownTemperatures((NOMINAL["ambient_c"],))
    ),
    "identify": lambda rig: identify.measure(rig.bench, rig.ask),
    "verify": lambda rig: verify.measure(rig.bench, rig.ask, verify.KnownParts()),
}


def first_day(
    rig: BlindRig, told: Callable[[str, Any], None] = lambda *_: None, until: str = ""
) -> Day:
    """Run the steps in the order of the guided path, up to `until`, or to a step that is refused or
    cannot run. Write the results of each step and restart the daemon before the next.
    """
    day = Day()
    for name, step in STEPS.items():
        try:
            result = step(rig)
        except HapticdError as error:
            day.error = f"{name}: {error}"
            break
        told(name, result)
        day.results.append(result)
        rig.write(result)
        if not result.settled or name == until:
            break
        if result.changes:
            rig.restart()
    return day
