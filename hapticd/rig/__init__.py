"""First day at the rig: from a bare board to values that somebody measured.

Each step is a module with `measure(bench, ..) -> StepResult`: it drives an ordinary client and
leaves the device disabled, and what it concludes comes from pure functions of arrays. `device_file`
writes what was found into the device file; `records` keeps what it was found from. Nothing here
knows a simulated board from a real one.
"""
