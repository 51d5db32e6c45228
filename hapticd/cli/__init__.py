"""The command line: each verb parses its arguments, calls one procedure, prints, and exits.

    app         all verbs under one name, `help`; errors become exit codes
    terminal    imports that happen at the first use of a module; shared options, output to stdout
                and stderr, the progress bar, figures on disk
    change      a connection to the daemon, NAME=VALUE arguments, receipts; numbers typed by people;
                guard; lease: leases of the environment and the damping
    daemon      run, status, get, set, damping, enable, disable, stop, reset, zero, home, dump,
                mark, perturb
    monitor     the lines of status, live in a terminal; events
    network     the operators' page; bridge lsl: telemetry for other tools; keys
    recording   record, rec, replay
    system      config, doctor, install-system
    sim         sim run, explain, effects, ceiling; accuracy; studies remedies; sim_board:
                sim-board
    zwidth/     zwidth predict, trial, limits, map, search, walls, import, report, compare

stdout is for data, stderr for messages. `--json` gives one object (or one per line for a stream),
also when a command fails. Colour only on a terminal and without NO_COLOR. Every HapticdError
becomes one line and its exit code:

    0 done   1 failed   2 usage   3 no daemon   4 refused   5 stopped or faulted
    6 requirement not met   78 configuration   130 interrupted

Large modules are imported within `terminal.deferred_imports()` and loaded on first use, so that
`--help` and the small verbs stay quick: no module here may import numpy, pydantic, zmq or rich at
its top in another way.
"""
