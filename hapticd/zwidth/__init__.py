"""The bench: trials, and what is found with many of them. Nothing here prints.

One trial is what `trial` plans, runs, judges and keeps; where its record comes from is a source:
the batch engine (`simulated`), a running daemon (`live`), the whole product on virtual time
(`lockstep`) or a file (`recorded`). Of many trials there are `limits` along an axis, the `map` of a
grid, the `search` with few trials and impacts on `walls`; all stand on `outcomes`, which runs,
judges and keeps batches of simulated trials.

Importing the package imports nothing else; a script imports the modules that it needs:

    trial       plan_trial, run_trial, write       one environment, judged, kept as a run folder
    outcomes    run_trials, Conditions             many simulated trials at once, each judged
    limits      plan_limits, run_limits            how far K, B or M goes along its axis
    map         plan_map, run_map                  the passive set on a grid
    search      plan_search, run_search            the same with few trials
    walls       plan_walls, run_walls              impacts on virtual walls (the paper's Fig. 2)
    simulated, live, lockstep, sources             sources of a trial's record
    recorded    read_file                          the record in a file of any program
    portable    portable, compare                  NAME.zwidth files, and displays beside each other
    interchange                                    Z(f) for the tools of control engineering

The rest serves these: `watch` (ends a trial before its time), `aligned`,
`hapticd_files` and `timestamps` (records of files), `scenes` (what procedures ask of a scene),
`stepped_sine` (a second opinion on an impedance), `store` (what is kept), `executors` (where many
trials run). Below them is `engine`, which simulates, above them `report`, which draws.
"""
