"""What Weir, Colgate and Peshkin (2008) print, and the simulated devices that stand for theirs.

D. W. Weir, J. E. Colgate and M. A. Peshkin, "Measuring and Increasing Z-Width with Active
Electrical Damping", Haptics Symposium 2008. Every number of the paper that is compared, drawn or
rendered stands here once; `rows` puts ours beside it.

    weir2008           calibrated: five numbers (friction, viscous damping, delay, lag of the
                       command, residual resistance) were fitted to the six printed limits
    weir2008_probe_hp  calibrated as well: a high-pass in the velocity channel explains the
                       limits instead of a lag in the path of the force
    weir2008_literal   the printed numbers alone: no lag, no friction, no physical damping

What would break it: a number that was read from a picture. The paper's curves exist only as
pictures, so nothing but its words and printed numbers is taken.
"""

MAIN = "weir2008"
HIGH_PASS = "weir2008_probe_hp"
LITERAL = "weir2008_literal"
ADDED_NS_PER_M = 1.74  # active damping, section 5
LEVELS = (0.0, ADDED_NS_PER_M)  # active damping that everything is asked at, N s/m
MODES = {0.0: "off", ADDED_NS_PER_M: "on"}  # the end of a quantity's name
NAMES = ("K_max", "B_max", "M_min")
UNITS = ("N/m", "Ns/m", "kg")  # of NAMES
PAPER = {  # the six limits, section 5
    "K_max_off": 100.0,
    "B_max_off": 3.0,
    "M_min_off": -0.008,
    "K_max_on": 600.0,
    "B_max_on": 8.0,
    "M_min_on": -0.022,
}
RATIOS = {"K": 6.0, "B": 2.7, "M": 2.75}  # damped over undamped, as printed
PERIOD_S = 1e-3  # of the servo
CROWBAR_NMS = 1.7e-4  # N m s/rad, Eq. 3: damping of the short-circuited motor
CROWBAR_NS = 3.7e-5  # N s/m: the same at the endpoint, as printed
WARMER_K = 40.0  # of the winding, in the paper's example
WARMER_PERCENT = 16.0  # what its resistance grows by, as printed
FIG_4 = (100.0, 1.0, 0.010)  # K N/m, B N s/m, M kg of the trial that is shown
FIG_7 = (50.0, 2.0, 0.0)
