"""Quantiles for statements about many frequencies at once. Standard library alone.

`sidak`: n statements that each hold with probability p^(1/n) hold together with at least p when
their errors are independent or, as between neighbouring values of a windowed spectrum, positively
correlated (Sidak 1967; Slepian 1962). It is taken over all values that are looked at: the number of
independent ones (band over bandwidth) is smaller, but with it a lossless device raises twice the
promised false alarms, because the extreme of a smooth curve lies between them.
"""

from math import atan, cos, isclose, pi, sin, sqrt, tan
from statistics import NormalDist

from hapticd.errors import AnalysisError

MANY = 18.0  # degrees of freedom from which the expansion holds


def sidak(confidence: float, statements: int) -> float:
    """Confidence that each of `statements` needs so that all hold together with `confidence`."""
    if not 0.0 < confidence < 1.0:
        raise AnalysisError(f"confidence {confidence}: must lie between 0 and 1; 0.95 is usual")
    return float(confidence ** (1.0 / max(1, statements)))


def student_quantile(probability: float, degrees_of_freedom: float) -> float:
    """Quantile of Student's t: Cornish-Fisher expansion in 1/nu (Abramowitz and Stegun 26.7.5),
    1e-4 of t from nu = 18 on.

    Below, where nu must be 1, 2, 3 .., it is exact. AnalysisError for any other nu below.
    """
    if degrees_of_freedom < MANY:
        return _few(probability, degrees_of_freedom)
    z = NormalDist().inv_cdf(probability)
    nu = degrees_of_freedom
    terms = (
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
        (79.0 * z**9 + 776.0 * z**7 + 1482.0 * z**5 - 1920.0 * z**3 - 945.0 * z) / 92160.0,
    )
    return z + sum(term / nu ** (power + 1) for power, term in enumerate(terms))


def _few(probability: float, degrees_of_freedom: float) -> float:
    """By halving, as P(t) is known in closed form; tan of the angle is t / sqrt(nu)."""
    nu = round(degrees_of_freedom)
    if nu < 1 or not isclose(nu, degrees_of_freedom):
        raise AnalysisError(
            f"{degrees_of_freedom:g} degrees of freedom: below {MANY:g} a whole number is needed;"
            " average more"
        )
    low = atan(-1e9)
    high = atan(1e9)
    for _ in range(100):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _student(middle, nu) < probability else (low, middle)
    return sqrt(nu) * tan(0.5 * (low + high))


def _student(angle: float, nu: int) -> float:
    """P(t) by a finite sum: 26.7.3 of Abramowitz and Stegun for odd nu, 26.7.4 for even nu."""
    odd = nu % 2
    term = cos(angle) if odd else 1.0
    total = term if nu > 1 else 0.0
    for place in range(1, nu // 2):
        term *= (2 * place - 1 + odd) / (2 * place + odd) * cos(angle) ** 2
        total += term
    inside = 2.0 / pi * (angle + sin(angle) * total) if odd else sin(angle) * total
    return 0.5 * (1.0 + inside)
