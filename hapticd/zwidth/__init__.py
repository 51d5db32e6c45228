"""The bench: trials, and the procedures that run many of them. Nothing here prints.

`trial` plans, runs, judges and stores one trial. Its record comes from a source: the batch engine
(`simulated`), a running daemon or the whole product on virtual time (`live`), or a file
(`recorded`). Procedures with many trials are `limits` along an axis, the `map` of a grid, the
`search` with few trials and impacts on `walls`. All use `outcomes`, which runs, judges and stores
batches of simulated trials.

Importing the package imports nothing else; a script imports the modules that it needs:

    trial       plan_trial, run_trial, write       one environment, judged, stored as a run folder
    outcomes    run_trials, Conditions             many simulated trials at once, each judged
    limits      plan_limits, run_limits            the limit of K, B or M along its axis
    map         plan_map, run_map                  the passive set on a grid
    search      plan_search, run_search            the same with few trials
    walls       plan_walls, run_walls              impacts on virtual walls (the paper's Fig. 2)
    simulated, live, sources  sources of a trial's record
    recorded    read_file                          the record in a file of any program
    portable    portable, compare                  NAME.zwidth files, and comparison of displays;
                Z(f) for the tools of control engineering
    passive_set PassiveSet, Envelope, axis_limit   the set of K, B and M; the Z-width envelope
    compare     widths_db, check_alike             numbers of displays, and conditions of comparison
    alignment   align                              a record of another system, aligned with ours

The other modules serve these: `watch` (ends a trial early), `aligned`, `timestamps` and `matching`
(records of files), `acquisition` and `surrogate` (the choice of the next trial of a search),
`store` (stored results), `executors` (threads, processes, clusters). `sources` also has
`Display`, the composed device of a scene with its predictions, and the stepped sine, an independent
measurement of an impedance. Below them is `engine`, which simulates. Above them is `report`, which
draws.
"""
