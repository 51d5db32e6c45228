"""The steps of commissioning, in the order of the guided path (hapticd/cli/rig/guided.py).

link               frames, delay, clocks, and the board's watchdog
encoder            sign and m per count, by hand
motor              sign by pushes; gain and offset by masses, or by a spring
winding            force per ampere, resistance, back-EMF and its channel; the sensor of the
                   winding's temperature
damping            polarity and scale of the active damping, by pushes
coast_down         momentum balance of a push, and the fit to all pushes
probe, probe_fits  both channels of the probe: gains, offsets, skew
identify           the device's own [model]: mass, friction, delay, smoothing
force_balance      its fit, of one rigid mass or two coupled ones; `force_terms` has the terms
mechanics          the mechanical parameters from that fit, with intervals
verify             known parts as the probe measures them; reference vectors of the installation
delivery           delivered force and damping while a hand moves the handle
"""
