"""The fault of a sample, as its number (`core.faults`), 0 for none.

Three methods check causes, each with more of them than the one before: `present` in any state,
`under_force` while there is force, and `against_force` before enabling. `newly_lost` is the fault
that a sample adds to a plan.
"""

from hapticd.core.faults import BY_CODE
from hapticd.core.params import ServoParams
from hapticd.core.units import round_half_up
from hapticd.servo.plan import (
    AMPLIFIER_TOLD,
    BOARD_FAULT,
    DEVICE_DIFFERS,
    GATEWAY_ALIVE,
    LINK_UP,
    NO_TEMPERATURE,
    Plan,
    Sample,
)
from hapticd.servo.safety import GRANTED, State
from hapticd.usb.codec import I16_HIGHEST, I16_LOWEST
from hapticd.usb.device import SEED
from hapticd.usb.frames import StatusBit

NO_AUTHORITY = BY_CODE["no_authority"].number
FRAMES_LOST = BY_CODE["frames_lost"].number
SENSOR_GLITCH = BY_CODE["sensor_glitch"].number
SHORT_S = 1.0  # in addition to the ramp of enabling: limit for force that is withheld again


class Causes:
    """The causes of faults, with the limits of `params`."""

    def __init__(self, params: ServoParams) -> None:
        self._params = params
        self._low_count, self._high_count = params.device.temperature_counts(
            I16_LOWEST, I16_HIGHEST
        )
        longest_s = params.safety.enable_ramp_s + SHORT_S
        self._longest_short = round_half_up(longest_s * params.realtime.rate_hz)

    def cool(self, temperature: int) -> bool:
        """Return whether the count of the winding's temperature is inside its limits."""
        return self._low_count <= temperature <= self._high_count

    def present(self, status: int, temperature: int, host: int) -> int:
        """Return the number of a fault that is present, 0 for none."""
        if not host & LINK_UP:
            return BY_CODE["usb_lost"].number
        if status & BOARD_FAULT:
            return BY_CODE["board_fault"].number
        allowed = self.cool(temperature) or host & NO_TEMPERATURE
        if status & StatusBit.OVER_TEMPERATURE or not allowed:
            return BY_CODE["over_temperature"].number
        return 0

    def under_force(self, sample: Sample) -> int:
        """Return a fault as `present`, or one that matters only under force. It prevents an enable
        and a reset.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        if found := self.present(status, temperature, host):
            return found
        if status & StatusBit.WATCHDOG:
            return BY_CODE["board_watchdog"].number
        return FRAMES_LOST if -arrival > self._params.safety.missing_frames_limit else 0

    def against_force(self, sample: Sample) -> int:
        """Return a fault as `under_force`, or a condition that may pass within a few ticks under
        force (contacts bounce). It prevents an enable and a reset too.
        """
        _, status, _, _, host, _, _, _, _ = sample
        if found := self.under_force(sample):
            return found
        ready = status & StatusBit.AMPLIFIER_READY or not host & AMPLIFIER_TOLD
        return 0 if ready and not status & StatusBit.EMERGENCY_STOP else NO_AUTHORITY

    def newly_lost(self, plan: Plan, sample: Sample, tick: int) -> int:
        """Return the number of a fault that this sample causes, 0 for none. Losses that matter only
        under force count only under force.
        """
        _, status, temperature, arrival, host, _, _, _, _ = sample
        if plan.state not in GRANTED:
            return self.present(status, temperature, host)
        if not host & GATEWAY_ALIVE and self._params.safety.on_gateway_loss == "fault":
            return self.present(status, temperature, host) or BY_CODE["gateway_lost"].number
        if arrival == SEED:
            return BY_CODE["board_restarted"].number
        if host & DEVICE_DIFFERS:
            return BY_CODE["device_differs"].number
        if len(plan.glitches) > self._params.safety.glitches_limit:
            return SENSOR_GLITCH
        if plan.unauthorised > self._params.safety.no_authority_limit:
            return self.under_force(sample) or NO_AUTHORITY
        if self._given_up(plan, tick):
            return self.under_force(sample) or (FRAMES_LOST if arrival < 0 else NO_AUTHORITY)
        return self.under_force(sample)

    def _given_up(self, plan: Plan, tick: int) -> bool:
        """Return whether force is withheld again without having been complete for too long."""
        short = plan.state is State.ENABLED and plan.unauthorised and plan.short_since >= 0
        return bool(short) and tick - plan.short_since > self._longest_short
