"""The true parameters of a blind rig, drawn from its seed, and the simulated board with them.

The board's hello and the nominal scales of its converters are NOMINAL. `Truth` has the real
properties of converters and mechanics. Steps access neither; they have only a client.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import pi
from random import Random
from typing import Any

from hapticd.core.units import COPPER_PER_K, PROBE_RATE_HZ, Clock
from hapticd.model.compose import board_fields, compose_device
from hapticd.model.effects import (
    Amplifier,
    Coulomb,
    Coupling,
    DampingCircuit,
    DampingDac,
    Masses,
    Motor,
    SensorNoise,
    Smoothing,
    Viscous,
    WindingHeating,
    WindingTemperature,
    WorkspaceEnds,
)
from hapticd.model.params import BoardParams
from hapticd.model.step import SUBSTEPS_PER_TICK, Plant, make_plant
from hapticd.sim.axis import Axis, Probe, i16_count
from hapticd.sim.backend import make_backend
from hapticd.sim.board import VENDOR_IN, BoardModel, hello
from hapticd.usb import codec
from hapticd.usb.frames import Request

I16 = codec.I16_HIGHEST
SERIAL = "BLIND"
NOMINAL: dict[str, Any] = {  # as config/devices/example-board.toml has them
    "serial": SERIAL,
    "rate_hz": 1000.0,
    "position_m_per_count": 0.5e-6,
    "force_n_per_count": 8.0 / I16,
    "active_damping_ns_per_m_per_count": 10.0 / codec.U16_HIGHEST,
    "probe_torque_n_per_count": 2.0 / I16,
    "probe_velocity_m_per_s_per_count": 2.0 / I16,
    "current_a_per_count": 10.0 / I16,
    "voltage_v_per_count": 30.0 / I16,
    "emf_velocity_m_per_s_per_count": 2.0 / I16,
    "force_limit_n": 8.0,
    "mass_kg": 0.005,
    "viscous_ns_per_m": 0.3,
    "lower_stop_m": -0.03,
    "upper_stop_m": 0.03,
    "torque_constant_n_per_a": 1.65,
    "winding_ohm": 1.6,
    "ambient_c": 22.0,
}
SUBSTEP_S = 1.0 / (SUBSTEPS_PER_TICK * NOMINAL["rate_hz"])
HIGHEST_DAMPING_NS_PER_M = 12.0
ONE_SIGNAL_COUNTS = 3000.0  # rms
BROKEN = (
    "damping polarity",
    "no authority",
    "stuck encoder",
    "dead probe channel",
    "slipping lever",
    "mass typed ten times wrong",
    "probe channels swapped",
)


@dataclass(frozen=True)
class Truth:
    """The real rig. Gains are the real value of a count over the value in the hello."""

    seed: int
    position_sign: int
    force_sign: int
    probe_torque_sign: int
    probe_velocity_sign: int
    position_gain: float
    force_gain: float
    active_damping_gain: float
    probe_torque_gain: float
    probe_velocity_gain: float
    emf_gain: float
    force_offset_count: float  # count at zero force
    probe_torque_offset_count: float  # recorded at no torque
    probe_velocity_offset_count: float
    encoder_noise_counts: float  # rms, before the counter
    probe_noise_m_per_s: float  # rms of a 4 kHz value
    delay_periods: float  # sample to force
    mass_kg: float
    viscous_ns_per_m: float
    coulomb_n: float
    rotor_share: float  # of that mass: the rest slides with the encoder
    resonance_hz: float  # of the two on the transmission
    resonance_ratio: float  # of critical damping
    smoothing_hz: float  # of the filter behind the converter of the force
    residual_ohm: float  # resistance that the circuit leaves of the winding; < 0: overcompensation
    amplifier_hz: float
    circuit_hz: float
    skew_us: float  # by which the recorded velocity comes later than the torque
    torque_highpass_hz: float
    velocity_highpass_hz: float
    start_m: float  # position of the handle, where the board's count begins
    mass_error: float  # relative, of all masses that are hung
    distance_error_m: float  # of the gauge

    @property
    def rotor_kg(self) -> float:
        """The mass that turns with the motor."""
        return self.rotor_share * self.mass_kg

    @property
    def slider_kg(self) -> float:
        """The mass that slides with the encoder."""
        return self.mass_kg - self.rotor_kg

    @property
    def coupling(self) -> dict[str, float]:
        """Spring and damper between the two."""
        reduced_kg = self.rotor_kg * self.slider_kg / self.mass_kg
        rate = 2.0 * pi * self.resonance_hz
        return {
            "stiffness_n_per_m": reduced_kg * rate * rate,
            "damping_ns_per_m": 2.0 * self.resonance_ratio * reduced_kg * rate,
        }

    @property
    def motor_n_per_a(self) -> float:
        """Endpoint force of an ampere."""
        return float(NOMINAL["torque_constant_n_per_a"]) * self.force_gain


def drawn(seed: int) -> Truth:
    """The truth of the rig `seed`."""
    random = Random(f"blind rig {seed}")

    def sign() -> int:
        return random.choice((-1, 1))

    def near(share: float) -> float:
        return random.uniform(1.0 - share, 1.0 + share)

    corner_hz = random.uniform(0.05, 0.2)
    return Truth(
        seed=seed,
        position_sign=sign(),
        force_sign=sign(),
        probe_torque_sign=sign(),
        probe_velocity_sign=sign(),
        position_gain=near(0.2),
        force_gain=near(0.2),
        active_damping_gain=near(0.2),
        probe_torque_gain=near(0.2),
        probe_velocity_gain=near(0.2),
        emf_gain=near(0.2),
        force_offset_count=random.uniform(-80.0, 80.0),
        probe_torque_offset_count=random.uniform(-20.0, 20.0),
        probe_velocity_offset_count=random.uniform(-20.0, 20.0),
        encoder_noise_counts=random.uniform(0.2, 0.6),
        probe_noise_m_per_s=random.uniform(0.5e-4, 2e-4),
        delay_periods=random.randint(2, 12) / SUBSTEPS_PER_TICK,
        mass_kg=random.uniform(0.004, 0.009),
        viscous_ns_per_m=random.uniform(0.2, 0.5),
        coulomb_n=random.uniform(0.02, 0.06),
        rotor_share=random.uniform(0.4, 0.7),
        resonance_hz=random.uniform(600.0, 900.0),
        resonance_ratio=random.uniform(0.03, 0.1),
        smoothing_hz=random.uniform(150.0, 400.0),
        residual_ohm=random.uniform(-0.03, 0.06),
        amplifier_hz=5000.0,
        circuit_hz=1000.0,
        skew_us=random.uniform(0.0, 60.0),
        torque_highpass_hz=corner_hz,
        velocity_highpass_hz=corner_hz * near(0.3),
        start_m=random.uniform(-0.008, 0.008),
        mass_error=random.gauss(0.0, 1e-3 / 1.96),
        distance_error_m=random.gauss(0.0, 10e-6 / 1.96),
    )


def blind_board(truth: Truth, attached_kg: float = 0.0) -> BoardParams:
    """Return the real properties of the board and its mechanics, with a mass fixed to
    the handle.
    """
    gains = {
        "position_m_per_count": truth.position_gain,
        "force_n_per_count": truth.force_gain,
        "force_limit_n": truth.force_gain,  # the board clamps counts
        "active_damping_ns_per_m_per_count": truth.active_damping_gain,
        "probe_torque_n_per_count": truth.probe_torque_gain,
        "probe_velocity_m_per_s_per_count": truth.probe_velocity_gain,
        "emf_velocity_m_per_s_per_count": truth.emf_gain,
    }
    real = NOMINAL | {name: gain * NOMINAL[name] for name, gain in gains.items()}
    model = compose_device("blind", _effects(truth, attached_kg), NOMINAL["rate_hz"])
    fields = real | board_fields(model, (), HIGHEST_DAMPING_NS_PER_M)
    fields |= {"sample_phase": 1.0 - truth.delay_periods, "seed": truth.seed}
    return BoardParams(**fields)


def _effects(truth: Truth, attached_kg: float) -> tuple[Any, ...]:
    ohm = float(NOMINAL["winding_ohm"])
    # the circuit assumes that the winding is colder by this difference
    colder_k = truth.residual_ohm / (ohm * COPPER_PER_K)
    return (
        Masses(rotor_kg=truth.rotor_kg, slider_kg=truth.slider_kg + attached_kg),
        Coupling(**truth.coupling),
        Viscous(rotor_ns_per_m=truth.viscous_ns_per_m),
        Smoothing(corner_hz=truth.smoothing_hz),
        Coulomb(rotor_n=truth.coulomb_n),
        DampingDac(
            quantum_ns_per_m=NOMINAL["active_damping_ns_per_m_per_count"]
            * truth.active_damping_gain
        ),
        Amplifier(bandwidth_hz=truth.amplifier_hz),
        DampingCircuit(bandwidth_hz=truth.circuit_hz),
        Motor(
            torque_constant_nm_per_a=truth.motor_n_per_a,
            lever_m=1.0,
            resistance_ohm=ohm,
            reference_c=NOMINAL["ambient_c"],
        ),
        WindingTemperature(
            temperature_c=NOMINAL["ambient_c"], compensated_c=NOMINAL["ambient_c"] - colder_k
        ),
        WindingHeating(
            thermal_resistance_k_per_w=8.0, time_constant_s=10.0, ambient_c=NOMINAL["ambient_c"]
        ),
        SensorNoise(velocity_m_per_s=truth.probe_noise_m_per_s),
        WorkspaceEnds(lower_m=NOMINAL["lower_stop_m"], upper_m=NOMINAL["upper_stop_m"]),
    )


class BlindProbe(Probe):
    """A probe whose channels have their own offsets, high-passes and skew."""

    __slots__ = (
        "_broken",
        "_corners",
        "_fed",
        "_kept",
        "_last",
        "_late",
        "_signal",
        "_truth",
        "_unrounded",
    )

    def __init__(self, params: BoardParams, truth: Truth, broken: str | None) -> None:
        self._truth = truth
        self._broken = broken
        corners_hz = (truth.torque_highpass_hz, truth.velocity_highpass_hz)
        self._corners = [2.0 * pi * hz / PROBE_RATE_HZ for hz in corners_hz]
        self._kept = [0.0, 0.0]
        self._last = 0.0
        self._late = truth.skew_us * 1e-6 * PROBE_RATE_HZ  # of a sample
        self._fed = 0  # samples that one signal is still fed into both channels
        self._unrounded = Random(f"rounding {truth.seed}").uniform
        self._signal = Random(f"one signal {truth.seed}").gauss
        super().__init__(params)

    def feed(self, seconds: float) -> None:
        """Feed white noise into both channels in place of the sensors."""
        self._fed = round(seconds * PROBE_RATE_HZ)

    def end_interval(self, travel_m: float, impulse_ns: float | None = None) -> None:
        """The pair of the interval, as its channels record it."""
        super().end_interval(travel_m, impulse_ns)
        torque = float(self.pairs[-2])
        velocity = float(self.pairs[-1])
        if self._fed:
            self._fed -= 1
            torque = self._signal(0.0, ONE_SIGNAL_COUNTS)
            velocity = torque + self._noise * self._gauss(0.0, 1.0)
        # it is rounded already; a converter rounds once, after skew, high-pass and offset
        velocity += self._unrounded(-0.5, 0.5)
        now = velocity
        velocity += self._late * (self._last - now)
        self._last = now
        torque = self._passed(0, torque) + self._truth.probe_torque_offset_count
        velocity = self._passed(1, velocity) + self._truth.probe_velocity_offset_count
        if self._broken == "dead probe channel":
            velocity = self._truth.probe_velocity_offset_count
        if self._broken == "probe channels swapped":
            torque, velocity = velocity, torque
        self.pairs[-2:] = [i16_count(torque), i16_count(velocity)]

    def _passed(self, channel: int, value: float) -> float:
        left = value - self._kept[channel]
        self._kept[channel] += self._corners[channel] * left
        return left


class BlindBoard:
    """The simulated board of `truth`, at which `outside(state, seconds)` [N] pulls at the handle.
    The plant's state outlives restarts of the daemon, as a device on a table does.
    """

    def __init__(self, truth: Truth, broken: str | None, outside: Callable[..., float]) -> None:
        self.truth = truth
        self.params = blind_board(truth)
        self._broken = broken
        self._outside = outside
        self._plants: dict[float, Plant] = {}
        self._noise = Random(f"encoder {truth.seed}").gauss
        self.plant = self._plant(0.0)
        self.state = self.plant.rest(truth.start_m)
        self._probe_sign = truth.probe_torque_sign
        self.watched = True  # until the signs are verified
        self.worst_n = 0.0  # of the motor meanwhile
        self.axis: Axis | None = None

    def attach(self, kilograms: float) -> None:
        """Add `kilograms` to the moving mass."""
        self.plant = self._plant(kilograms)

    def one_signal(self, seconds: float) -> None:
        """Feed one signal into both probe channels."""
        assert self.axis is not None
        probe: Any = self.axis.probe
        probe.feed(seconds)

    def _plant(self, kilograms: float) -> Plant:
        if kilograms not in self._plants:
            self._plants[kilograms] = make_plant(blind_board(self.truth, kilograms))
        return self._plants[kilograms]

    def backend(self, _params: BoardParams, clock: Clock, on_slip: Any = None) -> Any:
        """Replace `simulated_backend`: return this board for any parameters."""
        made = make_backend(self.params, clock, on_slip)
        port: Any = made._port
        board: BoardModel = port
        nominal = BoardParams(**NOMINAL)
        board._replies[VENDOR_IN, Request.HELLO.value, 0] = codec.encode_hello(hello(nominal))
        self._wire(board._axis)
        return made

    def _wire(self, axis: Axis) -> None:
        if self.axis is not None:
            self.state = self.axis.state
        truth = self.truth
        free = self.plant
        axis.probe = BlindProbe(self.params, truth, self._broken)
        axis.amplifier = self._motor
        axis.active_damping_gain = -1.0 if self._broken == "damping polarity" else 1.0
        axis.plant = free._replace(
            step=self._step,
            encoder=self._encoder,
            travel=lambda *seen: truth.probe_velocity_sign * free.travel(*seen),
            rest=lambda at_m: free.rest(truth.position_sign * at_m),
        )
        axis.zero_m = truth.position_sign * truth.start_m
        axis.move_on(self.state)
        axis.probe.power_up(axis.plant.travel(self.state, 0.0, 0.0))
        self.axis = axis

    def _motor(self, commanded_n: float) -> float:
        if self._broken == "no authority":
            return 0.0
        zero_n = self.truth.force_offset_count * self.params.force_n_per_count
        made_n = self.truth.force_sign * (commanded_n - zero_n)
        if self._broken == "slipping lever":
            made_n = max(-0.5, min(0.5, made_n))
        return made_n

    def _encoder(self, *seen: Any) -> float:
        if self._broken == "stuck encoder":
            return self.truth.position_sign * self.truth.start_m
        noise_m = self.truth.encoder_noise_counts * self.params.position_m_per_count
        at_m: float = self.plant.encoder(*seen)
        return self.truth.position_sign * at_m + noise_m * self._noise(0.0, 1.0)

    def _step(self, state: Any, force_n: float, torque_n: float, level: float, n: int) -> Any:
        pull_n = self._outside(state, n * SUBSTEP_S) + self._probe_sign * torque_n
        after = self.plant.step(state, force_n, pull_n, level, n)
        if self.watched:
            made_n = abs(self.plant.motor_force(after, force_n, level))
            self.worst_n = max(self.worst_n, made_n)
        return after
