"""Arrays in, results out: spectra, passivity verdicts, prediction, envelopes, boundaries and the
directed search.

Pure functions and frozen results; numpy alone. Where numba is installed (extra [fast]) the spectral
sums are compiled. Impedance is force applied to the device over its velocity, N s/m, at the probe
unless it says otherwise.
"""
