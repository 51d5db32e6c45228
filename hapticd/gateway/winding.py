"""The compensation of the winding's resistance, from the newest record.

The record contains the count of the resistance compensation and the temperature of the sensor. The
compensated resistance is base + trim. The actual resistance is known only with a sensor; without
one the residual, and with it the loop gain, is unknown (the servo then compensates the minimum
resistance of the winding). The physics is in `render.winding`.

The servo keeps the count of a board without the DAC at 0.
"""

from math import isfinite, nan
from typing import Any

from hapticd.core.params import DeviceParams
from hapticd.render.winding import LEAST_LOOP_GAIN, loop_gain, ohm


def compensation(record: dict[str, Any], device: DeviceParams) -> dict[str, Any] | None:
    """Return compensated and actual resistance [ohm], the residual, and the damping circuit's loop
    gain.

    The loop gain is given at the level in effect and at the device's maximum; unknown values are
    None. Return None before the first record, and for a device file without [resistance].

    `residual_ohm` > 0: the actual resistance exceeds the compensated one, so damping and force are
    weaker; < 0: they are stronger, and the circuit oscillates at a loop gain of -1.
    """
    table = device.resistance
    if table is None or not record:
        return None
    compensated_ohm = table.base_ohm + table.trim.to_value(record["resistance_count"])
    winding_c = float(record["winding_c"])
    found: dict[str, Any] = {
        "compensated_ohm": compensated_ohm,
        "tolerance_ohm": table.tolerance_ohm,
        "least_loop_gain": LEAST_LOOP_GAIN,
        **dict.fromkeys(("winding_c", "winding_ohm", "residual_ohm")),
        **dict.fromkeys(("loop_gain", "loop_gain_at_ceiling")),
    }
    if not isfinite(winding_c):
        return found
    residual_ohm = ohm(table, winding_c) - compensated_ohm
    effect = float(record.get("active_damping_effect_ns_per_m", nan))
    ceiling = device.active_damping_limit_ns_per_m
    return found | {
        "winding_c": winding_c,
        "winding_ohm": ohm(table, winding_c),
        "residual_ohm": residual_ohm,
        "loop_gain": loop_gain(table, residual_ohm, effect) if isfinite(effect) else None,
        "loop_gain_at_ceiling": loop_gain(table, residual_ohm, ceiling),
    }
