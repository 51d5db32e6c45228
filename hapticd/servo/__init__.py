"""The servo process: one thread, one loop, one tick after another. Standard library, pyusb and
the layers below.

    host        prepare, relax: real-time rights, and what the operating system granted
    loop        ServoLoop: the only `while`
    wait, rehearsal        how it waits for a deadline, and warms the caches meanwhile
    connection  BoardConnection: a board that is lost, looked for, or has started anew
    step        initial_state, make_step: one tick as a function, the fast path
    slow_path   the slow path of a tick: commands, ramps, homing
    causes      what is wrong with a sample, as the number of a fault
    samples     lost and doubted samples, and the origin behind them
    homing      HomingSearch: finds the stop or the index, or says why not
    plan        Plan, TickConstants, ServoState: what is intended, and what a tick needs of it;
                flatten, unflatten: a checkpoint
    commands    one command on one plan
    safety      TABLE: which command leads where, and what torque and damping a state allows
    inbox       Inbox: what a tick has to obey; Streamer: a waveform into the board's FIFO
    board_check, watchdog_trial   what a board must show before it may make force; frames withheld
    glitch, monitors       doubts about a sample; signs of a limit cycle
    easing, ramp_energy    how far a change may step the force, and what energy it may bring
    commissioning          what is watched while the signs are not verified
    compensation           when the winding's resistance is looked at
    energy_controller      ends a leak before the fault `energy` has to
    late                   why a tick was late
"""
