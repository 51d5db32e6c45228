"""The promises of a verdict, counted over many trials: false alarms, coverage of intervals, power.

Trials of 90 s are scaled down where only N / M matters: the sample rate with the window, or both
with the frequencies.
"""

from hapticd.signal.spectra import spa
from hapticd.signal.verdict import judge
from support.spectral_trials import record


def answers(z, noise_m_per_s, trials, band_hz=(16.0, 500.0), samples=45_000):
    """Shares of the three answers, and of trials that the plain +-90 degree rule calls passive."""
    found = []
    plain = 0
    for seed in range(trials):
        force, velocity = record(z, seed, samples, noise_m_per_s=noise_m_per_s)
        verdict = judge(spa(force, velocity, 4000.0, 256), band_hz=band_hz, channels=False)
        found.append(verdict.answer)
        plain += verdict.within_90_deg
    return {
        answer: found.count(answer) / trials for answer in ("passive", "not_passive", "undecided")
    }, plain / trials
