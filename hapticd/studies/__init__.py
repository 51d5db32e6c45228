"""Studies of scenes: what accuracy costs, which effects a question needs, single runs, remedies.

A study asks about the simulation itself, not about a display: how many sub-steps, which precision,
what length of a trial and which effects an answer needs. A study is a procedure of a frozen
plan: `plan_...` checks what is asked, `run_...` simulates and returns numbers.

    accuracy    plan_accuracy, run_accuracy: error against seconds for every way to run a scene;
                cost: seconds per simulated second
    effects     EffectsParams, plan_effects, run_effects: which effects change the answer
    scene       plan_scene, run_scene: a scene with active damping and without; ceiling: the largest
                active damping that is stable; compare_integrators: explicit methods on its device
    remedies    RemediesParams, run_remedies: what widens the passive set of which device, and at
                what price
    port_energy run_port_energy: the same by the energy given out in passive hands, also of laws
                that are not linear
    report      figures and tables of these
"""
