"""The rows of the table: what the paper says, what we find, and of which kind the agreement is.

    calibrated   a number that the device was fitted to, or by construction
    independent  nothing was fitted to it
    arithmetic   follows from numbers in the paper alone

Six limits were fitted with five numbers (friction, viscous damping, delay, lag of the command,
residual resistance): agreement there is a fit. Figs. 4, 7 and 8, the set readings and the lower
band edge were not used.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite, nan
from typing import Literal

from hapticd.analysis.theorem import required_damping
from hapticd.plant.effects import crowbar_nms_per_rad, lever_of_crowbar_m
from hapticd.units import COPPER_PER_K

Kind = Literal["calibrated", "independent", "arithmetic"]
PRINTED = "paper"  # the device of rows that need none
MAIN = "weir2008"
HIGH_PASS = "weir2008_probe_hp"
LITERAL = "weir2008_literal"
ADDED_NS_PER_M = 1.74  # Weir, Colgate and Peshkin 2008, section 5
LEVELS = (0.0, ADDED_NS_PER_M)
MODES = {0.0: "off", ADDED_NS_PER_M: "on"}
NAMES = ("K_max", "B_max", "M_min")
UNITS = ("N/m", "Ns/m", "kg")
PAPER = {
    "K_max_off": 100.0,
    "B_max_off": 3.0,
    "M_min_off": -0.008,
    "K_max_on": 600.0,
    "B_max_on": 8.0,
    "M_min_on": -0.022,
}
TOLERANCE = 0.08
RATIOS = {"K": 6.0, "B": 2.7, "M": 2.75}
PERIOD_S = 1e-3
CROWBAR_NMS = 1.7e-4
CROWBAR_NS = 3.7e-5
WARMER_K = 40.0
WARMER_PERCENT = 16.0
FIG_4 = (100.0, 1.0, 0.010)
FIG_7 = (50.0, 2.0, 0.0)


@dataclass(frozen=True, slots=True)
class Row:
    """`paper` is nan where the paper gives no number; `ours` where we find none; `sd` over
    `seeds`, nan without trials.
    """

    quantity: str
    paper: float
    ours: float
    unit: str
    kind: Kind
    device: str
    sd: float = nan
    seeds: int = 0
    predicted: float = nan
    note: str = ""
    part: str = ""  # of the page

    @property
    def difference(self) -> float:
        """Relative to the paper; nan without a number there."""
        return self.ours / self.paper - 1.0 if isfinite(self.paper) and self.paper else nan

    @property
    def matches(self) -> bool:
        """Within TOLERANCE of the paper, or nothing to compare with."""
        return not abs(self.difference) > TOLERANCE


def kind_of(device: str) -> Kind:
    """Of the six limits and what follows from them."""
    return "independent" if device == LITERAL else "calibrated"


def arithmetic(
    torque_constant_nm_per_a: float, resistance_ohm: float, lever_m: float
) -> tuple[Row, ...]:
    """Rows from the paper's numbers alone, and from the motor of the device where the paper
    gives none.
    """
    of_limits = ((PAPER[f"{name}_on"] / PAPER[f"{name}_off"], name[0]) for name in NAMES)
    told = (
        *(
            (f"{name}_ratio_printed", RATIOS[name], ratio, "1", "of the limits as printed")
            for ratio, name in of_limits
        ),
        (
            "K_gain_eq2",
            PAPER["K_max_on"] - PAPER["K_max_off"],
            2.0 * ADDED_NS_PER_M / PERIOD_S,
            "N/m",
            (
                "Eq. 2, b > KT/2 + B, lets 1.74 Ns/m buy seven times what the paper measured: the"
                " loop loses 3.5 ms, not T/2"
            ),
        ),
        (
            "eq2_fig4_damping",
            FIG_4[0] * PERIOD_S / 2.0 + FIG_4[1],
            float(required_damping([FIG_4])[0][0]),
            "Ns/m",
            (
                "paper: Eq. 2 as printed, ours: the theorem behind it with the paper's filters and"
                " virtual mass"
            ),
        ),
        (
            "eq3_crowbar",
            CROWBAR_NMS,
            crowbar_nms_per_rad(torque_constant_nm_per_a, resistance_ohm),
            "Nms/rad",
            "",
        ),
        (
            "eq3_crowbar_endpoint",
            CROWBAR_NS,
            CROWBAR_NMS / lever_m**2,
            "Ns/m",
            (
                "the two printed figures need a lever of"
                f" {lever_of_crowbar_m(CROWBAR_NMS, CROWBAR_NS):.2f} m; at {1e3 * lever_m:g} mm the"
                " crowbar damping is as large as what was added, not extremely small"
            ),
        ),
        (
            "copper_40_K",
            WARMER_PERCENT,
            100.0 * COPPER_PER_K * WARMER_K,
            "%",
            'printed "0.00393 percent per degree"; 0.393 % is meant',
        ),
    )
    return tuple(
        Row(name, paper, ours, unit, "arithmetic", PRINTED, note=note)
        for name, paper, ours, unit, note in told
    )


def by_quantity(rows: Iterable[Row]) -> dict[str, dict[str, Row]]:
    """{quantity: {device: row}} in order."""
    found: dict[str, dict[str, Row]] = {}
    for row in rows:
        found.setdefault(row.quantity, {})[row.device] = row
    return found
