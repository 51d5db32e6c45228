"""A perturbation of the probe while something is rendered, and both streams of what came of it.

The measuring lease is held meanwhile (`rig.streams`). Before the waveform the handle rests
under the environment: what the torque channel shows then is its offset. The servo's ticks say when
each sample was latched by the board's clock, which force was commanded, and how long the force
before it took; the probe's samples, 250 us each of the same clock, say force and motion.

What would break it: lost ticks or samples (refused: they leave a hole in the motion).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from hapticd.client.blocks import Records
from hapticd.client.client import Client
from hapticd.client.lease import ClientLease
from hapticd.core.arrays import Floats
from hapticd.core.environment import Environment
from hapticd.core.errors import AnalysisError
from hapticd.core.params import ScaleParams
from hapticd.core.units import PROBE_RATE_HZ, US_PER_S
from hapticd.rig.push import ready
from hapticd.rig.records import collect
from hapticd.rig.streams import Streams, Travel, inside, measuring, streams

REST_S = 0.6
RAMP_S = 0.5
SAMPLE_US = US_PER_S / PROBE_RATE_HZ


@dataclass(frozen=True, eq=False)
class Played:
    """n ticks and N samples of the probe, side by side."""

    board_us: Floats  # (n,) when the encoder was latched, by the board's clock
    position_m: Floats  # (n,)
    force_n: Floats  # (n,) commanded for the sample of that tick
    delay_us: Floats  # (n,) of the force in effect then, by the board's clock; negative: unknown
    last_index: Floats  # (n,) number of the newest sample that had come by then
    first_index: float  # number of the first sample
    torque_n: Floats  # (N,) interval means, without the offset of the channel
    velocity_m_per_s: Floats  # (N,) interval means

    @property
    def period_us(self) -> float:
        """Of the servo, by the board's clock."""
        return float(self.board_us[-1] - self.board_us[0]) / (len(self.board_us) - 1)

    def arrays(self, number: int) -> dict[str, npt.NDArray[Any]]:
        """What is kept, under names with that number."""
        return {f"{name}_{number}": np.asarray(value) for name, value in vars(self).items()}


def play(bench: Client, waveform_n: Floats, environment: Environment) -> Played:
    """Play `waveform_n` (n,) [N at 4 kHz] while `environment` is rendered; disabled afterwards.

    AnalysisError where force ends meanwhile, the handle leaves its travel, or records are lost.
    """
    stiffness, damping, mass = environment.free
    with measuring(bench) as lease, ready(bench):
        bench.set(K=stiffness, B=damping, M=mass, ramp_s=RAMP_S)
        bench.perturb_load(waveform_n)
        collect(bench, RAMP_S)
        still = _received(bench, lease, REST_S)
        bench.perturb_start()
        try:
            moving = _received(bench, lease, waveform_n.size / PROBE_RATE_HZ)
        finally:
            bench.perturb_stop()
    return _beside(still, moving, bench.hello().servo["device"])


def _received(bench: Client, lease: ClientLease, seconds: float) -> Streams:
    """Both streams for `seconds`, whole."""
    travel = _travel(bench)
    found = streams(bench, seconds, lambda ticks: inside(bench, ticks, travel), lease)
    if found.lost:
        raise AnalysisError(
            f"{found.lost} records were lost; quiet the host (`hapticd doctor`), and repeat the"
            " step"
        )
    return found


def _travel(bench: Client) -> Travel:
    ends = bench.hello().servo["environment"]["workspace"]
    return Travel(float(ends["lower_m"]), float(ends["upper_m"]))


def _signal(samples: Records, name: str, device: Mapping[str, Any]) -> Floats:
    """A channel of the probe in SI, by the scale of the device file."""
    scale = ScaleParams(**device[f"probe_{name}"])
    slope = scale.to_value(1.0) - scale.to_value(0.0)
    return np.asarray(scale.to_value(0.0) + slope * samples[name].astype(np.float64))


def _beside(still: Streams, moving: Streams, device: Mapping[str, Any]) -> Played:
    ticks = moving.ticks
    index = moving.samples["index"].astype(np.float64)
    newest = np.searchsorted(moving.samples["time_ns"], ticks["time_ns"], side="right") - 1
    inside = newest >= 0
    offset_n = float(_signal(still.samples, "torque", device).mean())
    return Played(
        ticks["board_us"][inside].astype(np.float64),
        ticks["position_m"][inside].astype(np.float64),
        ticks["force_n"][inside].astype(np.float64),
        ticks["delay_us"][inside].astype(np.float64),
        index[newest[inside]],
        float(index[0]),
        _signal(moving.samples, "torque", device) - offset_n,
        _signal(moving.samples, "velocity", device),
    )
