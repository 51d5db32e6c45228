"""Thirty recorded trials with hidden truth, and a score for any estimator's verdicts.

plan            devices, environments, and the truth of each trial by the linear theory files
a trial as CSV and npz; licence and description of the folder judge           the verdicts of
hapticd on such a folder, read like foreign files score           comparison of any estimator's
verdicts with the truth scenes/*.toml   the five devices

`python -m examples.trials make`, `judge` and `score` are the commands (docs/trials.md). Only public
names of hapticd are used, those in the `__all__` of its modules.
"""
