"""Octave as an independent reference: the script, its runner, and the golden file made with it.

`python -m tests.octave.run` regenerates golden.json.
"""
