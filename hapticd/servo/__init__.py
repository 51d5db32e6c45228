"""The servo process: one thread, one loop, one tick after another. Standard library, pyusb and the
layers below.

    loop        ServoLoop: the only `while`
    late        the cause of a late tick; the wait for a deadline, which warms the caches meanwhile
    connection  BoardConnection: the loss, search and return of a board, and its checks before it
                may make force
    step        initial_state, make_step: one tick as a function, the fast path
    slow_path   the slow path of a tick: commands, ramps, homing; the fault of a sample, as its
                number
    samples     lost and doubted samples, and the origin after them
    homing      HomingSearch: finds the stop or the index, or reports why it failed
    plan        Plan, TickConstants, ServoState: the intended state, and the constants of a tick;
                flatten, unflatten: a checkpoint
    commands    one command on one plan
    safety      TABLE: the state after each command, and the torque and damping of a state; the
                monitors of a limit cycle, and of unverified signs
    proxy       the anchor of the virtual spring, moved by the law of a client
    inbox       Inbox: requests and faults due at a tick; Streamer: a waveform into the board's FIFO
    watchdog_trial  frames withheld, for the board's watchdog
    energy      the limits on the force step and on the energy of a change; ends an energy leak
                before it becomes the fault `energy`
    compensation  the temperature of the winding and its compensation
"""
