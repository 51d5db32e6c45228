"""The command line: each verb parses its words, calls one procedure, prints, and exits.

    app         all verbs under one name, `help`; errors become exit codes
    terminal    options that verbs share, what is printed where, the progress bar, figures on disk
    change      a connection to the daemon, NAME=VALUE words, receipts
    numbers     numbers as people type them
    deferred    imports that happen at the first use of a module
    daemon      run, status, get, set, damping, enable, disable, stop, reset, zero, home, dump,
                mark, perturb
    monitor     the lines of status, live in a terminal; events
    console     the operators' page
    guard       guard; lease: leases of the environment and the damping
    bridge      bridge lsl: telemetry for other tools
    recording   record, rec, replay
    system      config, doctor, install-system
    keys        keys
    sim         sim run, explain, effects, ceiling; accuracy; studies remedies; sim_board:
                sim-board
    zwidth/     zwidth predict, trial, limits, map, search, walls, import, report, compare

stdout is data and stderr is talk. `--json` gives one object (or one per line for a stream), also
when a command fails. Colour only on a terminal and without NO_COLOR. Every HapticdError becomes one
line and its exit code:

    0 done   1 failed   2 usage   3 no daemon   4 refused   5 stopped or faulted
    6 requirement not met   78 configuration   130 interrupted

What is large is imported within `deferred.deferred_imports()` and loaded when a verb uses it, so
that `--help` and the small verbs stay quick: nothing here may import numpy, pydantic, zmq or rich
at its top in another way.
"""
