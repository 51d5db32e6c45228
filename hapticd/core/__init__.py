"""The common base of all packages.

No module here opens a board or a socket, and only `arrays` and `process` load more than small
modules of the standard library. The package imports nothing by itself.

    environment  `Environment`: rendered impedance, active damping, and the table of its fields;
                 limits of settings, declared with them and without pydantic
    params       frozen parameters in SI units, and their JSON form
    units        constants and small conversions; clocks, passed to all code that waits or takes
                 time stamps
    errors       the one error tree
    faults       every reason for which the servo leaves `enabled` by itself, with its remedy
    process      the start and the end of a process of hapticd; real-time rights
    arrays       array types and aligned arrays, in numpy
    extras       optional libraries, and how to install a missing one
    lazy         names of a package that are loaded on first use
"""
