"""Commissioning of a real rig: from a bare board to values that somebody measured.

    steps        a package with a module for each step: `measure(bench, ..) -> StepResult`
    experiment   how a step drives an ordinary client: lease, ramp, push, perturbation, records
    excitation   what the probe plays, and the recording of sines
    estimate     weighted least squares, block jackknife, intervals
    result       StepResult: values with intervals, findings, changes of the device file
    hand         what a step asks of a person, or of a program in their place
    device_file  measured values into the device file; raw records beside it
    certificate  what `verify` found, as JSON and as a page

A step leaves the device disabled. What it concludes comes from pure functions of arrays.
Nothing here knows a simulated board from a real one.
"""
