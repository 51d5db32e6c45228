"""The mathematics of a device: its effects, the composed model, its motion, and the sampled loop.

A scene lists effects. `compose` turns them into one linear state-space model, with the nonlinear
parts kept separately. The batch engine and the simulated board run that model. numpy is needed only
for composition and prediction. The simulated board runs on the standard library alone, so the
package imports nothing.

The device:

    effects      every effect of a device, one class each; KINDS, ALWAYS, BY_KEY
    scene        Scene, Excitation, DampingStep: the content of a simulation, in plain values
    compose      compose(scene), compose_device(name, effects): the composed Model;
                 board_fields(model): a model as the numbers of board.json
    model        Model and its parts, as frozen values
    params       parameters of a composed device, of the simulated board, and of the guard's worker
    discrete     discretise(model, duration_s): the exact map over a step; expm; `computable`;
                 stability, modes, damping_ceiling, explain
    excitation   torque_record: perturbation torque at 4 kHz
    friction     stick_one, stick_two: Coulomb friction solved exactly over a sub-step; reach: the
                 motor force within the limits of the amplifier
    step         make_plant(board parameters): the plant of a simulated board
    touch        contacts of the moving part: stops, a hand
    composed     the step of a composed model, as generated text
    blueprint    Blueprint and Form: the target of effects during composition

The sampled loop:

    loop         its first harmonic at the probe, exactly; its stability
    linearise    Coulomb friction as a damper of equal power
    theorem      `required_damping`, `lift`, `lifted_margin`: Colgate and Schenkel
    rational     `rational`, `positive_everywhere`: the theorem at all angles, without a grid
    angles       the angles at which a device is evaluated, dense about its modes; narrow dips of Re
                 Z, searched for at the poles of the loop
    coupled      `withstands`, `shaking_hand`: stability in passive hands; `forecast`: all of these
                 for one environment
    predict      `predict`, `predicted_impedance`: passivity without a trial
    bases        Theorem, Predicted, Measured: the grounds on which an environment is safe
"""
