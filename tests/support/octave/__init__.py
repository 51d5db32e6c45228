"""Octave as a second opinion: the script, how it is run, and the golden file that was made with it.

python -m tests.octave.run      makes golden.json again
"""
