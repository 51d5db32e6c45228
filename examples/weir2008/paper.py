"""Printed numbers of Weir, Colgate and Peshkin (2008), and the simulated devices that represent
theirs.

D. W. Weir, J. E. Colgate and M. A. Peshkin, "Measuring and Increasing Z-Width with Active
Electrical Damping", Haptics Symposium 2008. The compared numbers are in `rows.toml`, the drawn or
rendered ones here; `rows` compares ours with them.

    weir2008           calibrated: five numbers (friction, viscous damping, delay, lag of the
                       command, residual resistance) were fitted to the six printed limits
    weir2008_probe_hp  calibrated as well: a high-pass in the velocity channel explains the
                       limits instead of a lag in the path of the force
    weir2008_literal   the printed numbers alone: no lag, no friction, no physical damping

No number may be read from a picture. The paper's curves exist only as pictures, so only its text
and its printed numbers are used.
"""

import tomllib
from pathlib import Path

from hapticd.core.errors import AnalysisError

MAIN = "weir2008"
HIGH_PASS = "weir2008_probe_hp"
LITERAL = "weir2008_literal"
ADDED_NS_PER_M = 1.74  # active damping, section 5
LEVELS = (0.0, ADDED_NS_PER_M)  # levels of active damping used throughout, N s/m
MODES = {0.0: "off", ADDED_NS_PER_M: "on"}  # suffix of a quantity's name
NAMES = ("K_max", "B_max", "M_min")
PERIOD_S = 1e-3  # of the servo
WARMER_K = 40.0  # of the winding, in the paper's example
FIG_4 = (100.0, 1.0, 0.010)  # K N/m, B N s/m, M kg of the shown trial
FIG_7 = (50.0, 2.0, 0.0)

SECTIONS = tomllib.loads(Path(__file__).with_name("rows.toml").read_text("utf-8"))
NUMBERS = {
    row["quantity"]: row["paper"]
    for section in SECTIONS.values()
    if isinstance(section, dict)
    for row in section.get("rows", ())
    if "paper" in row
}
# the six limits, section 5
PAPER = {f"{name}_{mode}": NUMBERS[f"{name}_{mode}"] for mode in MODES.values() for name in NAMES}


def paper_equation_2(
    stiffness_n_per_m: float,
    virtual_damping_ns_per_m: float,  # virtual damping B
    physical_ns_per_m: float,  # b, of the device itself
    rate_hz: float = 1000.0,
) -> bool:
    """Return whether Eq. 2 of Weir, Colgate and Peshkin (2008) as printed holds: b > K T / 2 + B,
    for unfiltered velocity, no delay and no virtual mass.

    AnalysisError for B < 0, where the underlying theorem requires b > K T / 2 + |B| and Eq. 2 would
    require less. Also for K < 0, which no damping makes passive.
    """
    if stiffness_n_per_m < 0.0:
        raise AnalysisError(
            f"Eq. 2 does not hold for K = {stiffness_n_per_m:g} N/m: it would relax for a negative"
            " stiffness, which is active at low frequencies under any damping; render K >= 0"
        )
    if virtual_damping_ns_per_m < 0.0:
        needed = stiffness_n_per_m / (2.0 * rate_hz) - virtual_damping_ns_per_m
        raise AnalysisError(
            f"Eq. 2 does not hold for B = {virtual_damping_ns_per_m:g} N s/m: printed as"
            " b > KT/2 + B it would relax for negative virtual damping, the theorem asks for"
            " b > KT/2 - B cos wT,"
            f" here {needed:g} N s/m at 0 Hz; use required_damping"
        )
    return physical_ns_per_m > stiffness_n_per_m / (2.0 * rate_hz) + virtual_damping_ns_per_m
