"""Quantiles for statements about many frequencies at once. Standard library alone.

`sidak`: n statements that each hold with probability p^(1/n) hold together with at least p when their errors are
independent or, as between neighbouring values of a windowed spectrum, positively correlated (Sidak 1967; Slepian 1962). It
is taken over all values that are looked at: the number of independent ones (band over bandwidth) is smaller, but with it a
lossless device raises twice the promised false alarms, because the extreme of a smooth curve lies between them.
"""

from statistics import NormalDist

from hapticd.errors import AnalysisError


def sidak(confidence: float, statements: int) -> float:
    """Confidence that each of `statements` needs so that all hold together with `confidence`."""
    if not 0.0 < confidence < 1.0:
        raise AnalysisError(f"confidence {confidence}: must lie between 0 and 1; 0.95 is usual")
    return float(confidence ** (1.0 / max(1, statements)))


def student_quantile(probability: float, degrees_of_freedom: float) -> float:
    """Quantile of Student's t: Cornish-Fisher expansion in 1/nu (Abramowitz and Stegun 26.7.5), 1e-4 of t from nu = 20 on."""
    z, nu = NormalDist().inv_cdf(probability), degrees_of_freedom
    terms = (
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
        (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
    )
    return z + sum(term / nu ** (power + 1) for power, term in enumerate(terms))
