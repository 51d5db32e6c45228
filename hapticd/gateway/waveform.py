"""Transfer the perturbation waveform into the segment from which the servo plays it.

It arrives in consecutive chunks (a message holds 64 kB) and is converted from newtons into counts
of the board's probe converter. The caller (`commands`) checks that no waveform is playing; the
segment is written only then.

All chunks of a waveform come from one client (a second client is refused). A new life of the servo
starts without a waveform.
"""

import numpy as np
from numpy.typing import NDArray

from hapticd.core.errors import CommandError
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.mailbox.layout import PERTURBATION_SAMPLES
from hapticd.protocol.limits import CommandLimits
from hapticd.protocol.schemas import Perturb, invalid
from hapticd.protocol.view import ServoView
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST


class Waveform:
    """The loaded part of a waveform. A new servo life starts without one."""

    def __init__(self, limits: CommandLimits) -> None:
        self._limits = limits
        self._life = 0
        self._samples = 0
        self._actor = 0

    def samples(self, view: ServoView) -> int:
        """Return the number of samples loaded in the present servo life."""
        return self._samples if view.life == self._life else 0

    def load(self, request: Perturb, view: ServoView, actor: int) -> int:
        """Append the chunk of `request` by `actor`; return the number of samples loaded.

        CommandError (`invalid`, `refused`): nothing changed.
        """
        if view.mailbox is None:
            why = view.trouble if view.foreign else "no servo runs; start it with `hapticd run`"
            raise CommandError("servo_down", f"perturb load: {why}")
        loaded = self.samples(view)
        force_n = samples_n(request.samples_n)
        if request.offset not in (0, loaded):
            raise CommandError(
                "refused",
                f"offset = {request.offset} samples: {loaded} are loaded; send the chunks in order",
            )
        total = request.offset + len(force_n)
        if total > PERTURBATION_SAMPLES:
            limit = f"{PERTURBATION_SAMPLES} samples ({PERTURBATION_SAMPLES / PROBE_RATE_HZ:.0f} s)"
            reason = (
                f"samples_n: {total} samples are beyond the limit {limit}; shorten it or play it in"
                " a loop"
            )
            raise invalid([{"loc": "samples_n", "msg": reason}])
        if request.offset and actor != self._actor:
            raise CommandError(
                "refused",
                f"offset = {request.offset} samples: another client's are loaded; begin with"
                " offset 0",
            )
        self._check(force_n, request.offset)
        to_count = view.params.device.probe_torque.to_count
        for place, value in enumerate(force_n.tolist(), request.offset):
            view.mailbox.waveform[place] = to_count(value, I16_LOWEST, I16_HIGHEST)
        self._life = view.life
        self._samples = total
        self._actor = actor
        return total

    def _check(self, force_n: NDArray[np.float64], offset: int) -> None:
        limit = self._limits.of["samples_n"]
        # not `<` or `>`: NaN must be found as well
        wrong = np.flatnonzero(~((force_n >= limit.low) & (force_n <= limit.high)))
        if wrong.size:
            first = int(wrong[0])
            value_n = float(force_n[first])
            message = self._limits.complaint("samples_n", value_n, f"samples_n[{offset + first}]")
            found = {"loc": f"samples_n.{offset + first}", "msg": message}
            raise invalid([found | self._limits.numbers("samples_n", value_n)])


def samples_n(sent: list[float] | bytes) -> NDArray[np.float64]:
    """Return force samples [N], float64 (n,), from a list of numbers or little-endian float32
    bytes.

    CommandError `invalid`: incomplete samples.
    """
    if isinstance(sent, bytes):
        if len(sent) % 4:
            reason = (
                f"samples_n has {len(sent)} bytes: not whole little-endian float32; send 4 bytes a"
                " sample"
            )
            raise invalid([{"loc": "samples_n", "msg": reason}])
        return np.frombuffer(sent, "<f4").astype(np.float64)
    return np.array(sent, np.float64)
