"""The circuit in ngspice in place of the simulated board's plant: the same servo, wire and firmware
drive transistors, motor and masses, not the composed model.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import support.firmware_board as firmware_board
from firmware_iface.hardware.netlist import deck
from firmware_iface.hardware.shared import Transient
from firmware_iface.hardware.studies import FULL_NS_PER_M, K_F, V_PER_V
from hapticd.mailbox.layout import TELEMETRY, Command, Value
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK, Plant, make_plant
from hapticd.run.lockstep import LockStep, scene_params

SETTLING_S = 0.04  # of relay and amplifier after power-up, before the board starts
ENABLE_S = 0.02  # shorter than for a person: everything is in force before the kick
KICK_N = 0.02  # small: undamped it grows a hundredfold in the time that is compared
KICK = range(60 * SUBSTEPS_PER_TICK, 62 * SUBSTEPS_PER_TICK)  # sub-steps
RECORD = np.dtype(list(TELEMETRY))
SCENE = """
title = "the circuit of the netlist, without dry friction"
device = "weir2008_circuit"
effects = [
  "probe", "coupling", "viscous", "delay", "smoothing", "amplifier", "damping_circuit",
  "multiplier", "winding", "inductance",
]
seconds = 1.0
[environment]
stiffness_n_per_m = {stiffness}
virtual_damping_ns_per_m = {virtual_damping}
mass_kg = 0.0
[[active_damping]]
level_ns_per_m = {level}
"""


class CircuitPlant:
    """The circuit as a `Plant`; its state is the last output of ngspice."""

    def __init__(self, params: BoardParams) -> None:
        text = deck(
            [".tran 10u 100 0 50u uic"],
            ["v(force)", "v(rotor)", "v(position)", "v(travel)", "v(estimate)"],
            inputs={"dac": "external", "level": "external", "push": "external"},
        )
        self.full_n = params.force_n_per_count * 32767
        self.run = Transient(text, {"vdac": 1.25, "vlevel": 0.0, "ipush": 0.0})
        self.substep_s = 1.0 / (SUBSTEPS_PER_TICK * params.rate_hz)
        self.done = 0
        self.values = self.run.advance(SETTLING_S)

    def step(self, _: Any, force_n: float, torque_n: float, level: float, substeps: int) -> Any:
        """Return the output of ngspice `substeps` later."""
        self.run.inputs["vdac"] = 1.25 * (1.0 + force_n / self.full_n)
        self.run.inputs["vlevel"] = level / FULL_NS_PER_M
        self.run.inputs["ipush"] = torque_n
        self.done += substeps
        self.values = self.run.advance(SETTLING_S + self.done * self.substep_s)
        return self.values

    def plant(self) -> Plant:
        """Return the plant in the form that the board takes."""
        return Plant(
            rest=lambda _: self.values,
            step=self.step,
            encoder=lambda state, *_: 1e-3 * state["position"],
            travel=lambda state, *_: 1e-3 * state["travel"],
            impulse=None,
            motor_force=lambda state, *_: state["force"],
            estimate=lambda state, *_: state["estimate"] / (K_F * V_PER_V),
            celsius=None,
        )


@contextmanager
def plants(in_ngspice: bool) -> Iterator[Any]:
    """Yield the maker of the next board's plant: the circuit or the composed model, each kicked."""
    made: list[CircuitPlant] = []

    def make(params: BoardParams) -> Plant:
        if not in_ngspice:
            return kicked(make_plant(params))
        made.append(CircuitPlant(params))
        return kicked(made[-1].plant())

    yield make
    for one in made:
        one.run.close()


def kicked(plant: Plant) -> Plant:
    """Return `plant` with a push of KICK_N for two ticks at the rotor, at any position of the
    pieces.
    """
    done = 0

    def step(state: Any, force_n: float, torque_n: float, level: float, substeps: int) -> Any:
        nonlocal done
        for _ in range(substeps):
            push_n = torque_n + (KICK_N if done in KICK else 0.0)
            state = plant.step(state, force_n, push_n, level, 1)
            done += 1
        return state

    return plant._replace(step=step)


def flown(
    folder: Path, monkeypatch: Any, point: tuple[float, float, float], ticks: int, in_ngspice: bool
) -> np.ndarray:
    """Position [m] (ticks,) of servo, wire, compiled firmware and plant in lock-step, from the tick
    of the kick on; `point` is K, B and active damping.
    """
    stiffness, damping, level = point
    scene = folder / "circuit.toml"
    scene.write_text(SCENE.format(stiffness=stiffness, virtual_damping=damping, level=level))
    servo, board = scene_params(scene)
    servo = replace(servo, safety=replace(servo.safety, enable_ramp_s=ENABLE_S))
    with plants(in_ngspice) as make:
        monkeypatch.setattr(firmware_board, "make_plant", make)
        monkeypatch.setattr("hapticd.sim.backend.make_board", firmware_board.FirmwareBoard)
        with LockStep(servo, board) as stack:
            stack.run(5)
            stack.do(Command.ENABLE)
            if level:
                stack.do(
                    Command.DAMPING, {Value.ACTIVE_DAMPING: level, Value.ACTIVE_DAMPING_ON: 1.0}
                )
            stack.run(62 + ticks)
            records = np.frombuffer(b"".join(stack.blocks), dtype=RECORD)
    return records["position_m"][-ticks:]
