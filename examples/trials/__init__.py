"""Thirty recorded trials with hidden truth, and a score for any estimator's verdicts.

plan            devices, environments, and what is true of each trial by the linear theory
files           a trial as CSV and npz; licence and description of the folder
judge           the verdicts of hapticd on such a folder, read as a stranger's files
score           verdicts of any estimator beside the truth
scenes/*.toml   the five devices

`python -m examples.trials make`, `judge` and `score` are the commands (docs/trials.md). Of hapticd
only public names are used, those in the `__all__` of its modules.
"""
