"""Studies of scenes: the cost of accuracy, the effects that a question needs, single runs,
remedies.

A study concerns the simulation itself, not a display: the sub-steps, precision, length of a trial
and effects that an answer needs. It is a procedure with a frozen plan: `plan_...` checks the
request, `run_...` simulates and returns numbers.

    accuracy    plan_accuracy, run_accuracy: error against seconds for every way to run a scene
    effects     EffectsParams, plan_effects, run_effects: which effects change the answer; cost:
                seconds per simulated second
    scene       plan_scene, run_scene: a scene with active damping and without; ceiling: the largest
                active damping that is stable; compare_integrators: explicit methods on its device
    remedies    RemediesParams, run_remedies: remedies that widen the passive set of a device, and
                their price
    port_energy run_port_energy: the same by the energy given out in passive hands, also for laws
                that are not linear
    report      figures and tables of a scene; `report_methods` those of the other studies
"""
