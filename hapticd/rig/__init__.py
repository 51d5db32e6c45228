"""Commissioning of a real rig: from an unknown board to measured values with intervals.

    steps        a package with a module for each step: `measure(bench, ..) -> StepResult`
    experiment   how a step drives an ordinary client: lease, ramp, push, perturbation, records
    excitation   perturbation waveforms of the probe, and the recording of sines
    result       StepResult: values with intervals, findings, changes of the device file; weighted
                 least squares, block jackknife, intervals; requests of a step to a person, or to a
                 program in their place
    certificate  result of `verify`, as JSON and as a page; writes measured values into the device
                 file and keeps raw records next to it

A step leaves the device disabled. Its conclusions come from pure functions of arrays. No module
here distinguishes a simulated board from a real one.
"""
