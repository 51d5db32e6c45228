"""What Weir, Colgate and Peshkin (2008) print, and the simulated devices that stand for theirs.

D. W. Weir, J. E. Colgate and M. A. Peshkin, "Measuring and Increasing Z-Width with Active
Electrical Damping", Haptics Symposium 2008. The numbers that are compared stand in `rows.toml`,
those that are drawn or rendered here; `rows` puts ours beside them.

    weir2008           calibrated: five numbers (friction, viscous damping, delay, lag of the
                       command, residual resistance) were fitted to the six printed limits
    weir2008_probe_hp  calibrated as well: a high-pass in the velocity channel explains the
                       limits instead of a lag in the path of the force
    weir2008_literal   the printed numbers alone: no lag, no friction, no physical damping

What would break it: a number that was read from a picture. The paper's curves exist only as
pictures, so nothing but its words and printed numbers is taken.
"""

import tomllib
from pathlib import Path

MAIN = "weir2008"
HIGH_PASS = "weir2008_probe_hp"
LITERAL = "weir2008_literal"
ADDED_NS_PER_M = 1.74  # active damping, section 5
LEVELS = (0.0, ADDED_NS_PER_M)  # active damping that everything is asked at, N s/m
MODES = {0.0: "off", ADDED_NS_PER_M: "on"}  # the end of a quantity's name
NAMES = ("K_max", "B_max", "M_min")
PERIOD_S = 1e-3  # of the servo
WARMER_K = 40.0  # of the winding, in the paper's example
FIG_4 = (100.0, 1.0, 0.010)  # K N/m, B N s/m, M kg of the trial that is shown
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
