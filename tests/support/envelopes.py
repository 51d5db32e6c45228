"""Envelopes of trials that were measured one by one, of those that are passive."""

from collections.abc import Iterable
from functools import reduce
from typing import NamedTuple

from hapticd.signal.impedance import Impedance
from hapticd.signal.verdict import Verdict
from hapticd.zwidth.passive_set import Envelope


class EnvelopeTrial(NamedTuple):
    """One measured environment, by the name that its points of the envelope bear."""

    name: str
    impedance: Impedance
    verdict: Verdict


def of_trial(trial: EnvelopeTrial) -> Envelope:
    z = trial.impedance
    return Envelope.of_one(
        trial.name, z.frequency_hz, z.impedance_ns_per_m, z.relative_sd, z.port, z.estimator
    )


def envelope(trials: Iterable[EnvelopeTrial]) -> Envelope:
    return reduce(
        Envelope.merged, (of_trial(trial) for trial in trials if trial.verdict.answer == "passive")
    )
