"""The device between two servo commands: its effects, the composed model, and how it moves.

A scene names effects; `compose` turns them into one linear state-space model with what is not
linear beside it; the batch engine and the simulated board play that model. numpy is needed only
while composing: the simulated board runs on the standard library alone.

For scripts:

    effects      every effect of a device, one class each; KINDS, ALWAYS, BY_KEY
    scene        Scene, Excitation, DampingStep: what is simulated, in plain values
    compose      compose(scene), compose_device(name, effects): the composed Model
    model        Model and its parts, as frozen values
    discrete     discretise(model, duration_s): the exact map over a step; expm
    stability    stability, modes, damping_ceiling, explain
    excitation   torque_record: perturbation torque at 4 kHz
    friction     stick_one, stick_two: Coulomb friction solved exactly over a sub-step
    drive        reach: what the limits of the amplifier leave of the motor force
    step         make_plant(board parameters): the plant of a simulated board
    tables       board_fields(model): a model as the numbers of board.json
    blueprint    Blueprint and Form: what an effect writes into
"""
