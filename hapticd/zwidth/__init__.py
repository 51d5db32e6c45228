"""The bench: trials, and what is found with many of them. Nothing here prints.

One trial is what `trial` plans, runs, judges and keeps; where its record comes from is a source:
the batch engine (`simulated`), a running daemon (`live`), the whole product on virtual time
(`lockstep`) or a file (`recorded`). Of many trials there are `limits` along an axis, the `map` of a
grid, the directed `search` and impacts on `walls`; all stand on `outcomes`, which runs, judges and
keeps batches of simulated trials.

Importing the package imports nothing else: a script takes the modules that it needs.
"""
