"""Composition roots: modules that assemble clocks, boards, links, loops and processes.

No module here prints, and each imports only the dependencies of its own process.

    supervisor       Supervisor: starts, restarts and ends servo and gateway; write(folder,
                     settings, instance): the JSON files that processes start from
    lockstep         LockStep: the whole stack on virtual time; LockStepClient: a client of it;
                     scene_params, run_lockstep: a scene, and a trial of it; virtual: a client with
                     a guard
    system_files     files that a machine needs to run hapticd as a service
    doctor           checks of the machine for real-time use, and the support report

`servo_main`, `gateway_main` and `watchdog` are processes: `python -m hapticd.run.NAME`.
"""
