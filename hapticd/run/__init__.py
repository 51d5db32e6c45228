"""Composition roots: where clocks, boards, links, loops and processes are put together.

Nothing here prints, and each module imports only what its own process needs.

For scripts:

    lockstep      LockStep: the whole stack on virtual time; scene_params(scene)
    replay        replay(params, segment): `servo.step` over a recording, bit by bit
    resolve       write(folder, settings, instance): the JSON files that processes start from
    supervisor    Supervisor: starts, restarts and ends servo and gateway
    system_files  what a machine needs to run hapticd as a service
    process       die_with_parent, on_stop, notify: the end of a process, words to systemd

`servo_main`, `gateway_main` and `watchdog` are processes: `python -m hapticd.run.NAME`.
"""
