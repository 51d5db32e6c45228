"""What a device does, as mathematics: its effects, the composed model, how it moves, and the
sampled loop round it.

A scene names effects; `compose` turns them into one linear state-space model with what is not
linear beside it; the batch engine and the simulated board play that model. numpy is needed only
while composing and predicting: the simulated board runs on the standard library alone, so the
package imports nothing.

The device:

    effects      every effect of a device, one class each; KINDS, ALWAYS, BY_KEY
    scene        Scene, Excitation, DampingStep: what is simulated, in plain values
    compose      compose(scene), compose_device(name, effects): the composed Model
    model        Model and its parts, as frozen values
    discrete     discretise(model, duration_s): the exact map over a step; expm; what numbers of a
                 model can be computed with
    stability    stability, modes, damping_ceiling, explain
    excitation   torque_record: perturbation torque at 4 kHz
    friction     stick_one, stick_two: Coulomb friction solved exactly over a sub-step
    drive        reach: what the limits of the amplifier leave of the motor force
    step         make_plant(board parameters): the plant of a simulated board
    tables       board_fields(model): a model as the numbers of board.json
    touch        what touches the moving part beside its motor: stops, a hand
    composed     the step of a composed model, as generated text
    blueprint    Blueprint and Form: what an effect writes into

The sampled loop:

    loop         its first harmonic at the probe, exactly; whether it is stable
    linearise    Coulomb friction as the damper that takes the same power
    theorem      `required_damping`, `lift`, `lifted_margin`: Colgate and Schenkel
    rational     `rational`, `positive_everywhere`: the theorem at all angles, without a grid
    angles       where a device is looked at, dense about its modes
    narrow       narrow dips of Re Z, sought at the poles of the loop
    coupled      `withstands`, `shaking_hand`: what a passive hand can do
    predict      `predict`, `predicted_impedance`: passive or not without a trial
    forecast     `forecast`: all of these about one environment
"""
