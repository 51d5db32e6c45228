"""The steps of commissioning, in the order of the guided path (hapticd/cli/rig/guided.py).

link               frames, delay, clocks, and the board's watchdog
encoder            sign and m per count, by hand
motor, spring      sign by pushes; gain and offset by masses, or by a spring
winding            force per ampere, resistance, back-EMF and its channel
damping            polarity and scale of the active damping, by pushes
coast_down         the balance of momentum of a push, and what all pushes say together
probe, probe_fits  both channels of the probe: gains, offsets, skew
temperature        the sensor of the winding's temperature
identify           the device's own [model]: mass, friction, delay, smoothing
force_balance      its fit, of one rigid mass or two coupled ones; `force_terms` has the terms
mechanics          what that says of the device, with intervals
verify             known parts as the probe sees them; `reference_vectors` of the installation
delivery           what is delivered of force and damping while a hand moves the handle
"""
