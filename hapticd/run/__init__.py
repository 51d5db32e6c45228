"""Composition roots: where clocks, boards, links, loops and processes are put together.

Nothing here prints, and each module imports only what its own process needs.

    supervisor       Supervisor: starts, restarts and ends servo and gateway
    resolve          write(folder, settings, instance): the JSON files that processes start from
    lockstep         LockStep: the whole stack on virtual time; scene_params(scene)
    lockstep_client  LockStepClient: a client of that stack; virtual: one with a guard
    system_files     what a machine needs to run hapticd as a service
    doctor           what a machine lacks for real time, and the report for a question
    replay           replay(params, segment): the step over a recording, bit by bit

`servo_main`, `gateway_main` and `watchdog` are processes: `python -m hapticd.run.NAME`.
"""
