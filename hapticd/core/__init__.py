"""What every part agrees on.

Nothing here opens a device or a socket, and only `arrays` and `process` load more than the
standard library's small modules. The package imports nothing by itself.

    environment  `Environment`: what is rendered and damped, and the one table of its fields
    params       frozen parameters in SI units, and their JSON form
    constraints  limits of settings, declared beside them without pydantic
    units        constants and small conversions
    errors       the one error tree
    faults       every reason for which the servo leaves `enabled` by itself, with its remedy
    clock        clocks, passed to whatever waits or stamps
    process      how a process of hapticd ends, and what it tells systemd
    arrays       array types and aligned arrays, in numpy
    extras       optional libraries, and how a missing one is installed
    lazy         names of a package that are loaded when they are first used
"""
