"""Closed forms of dry friction that tests compare with."""


def stop_time_s(mass_kg: float, velocity_m_per_s: float, coulomb_n: float) -> float:
    """Return when a mass that slides against Coulomb friction comes to rest: m |v| / Fc."""
    return mass_kg * abs(velocity_m_per_s) / coulomb_n


def turning_points_m(start_m: float, stiffness_n_per_m: float, coulomb_n: float) -> list[float]:
    """Positions at which a mass on a spring with Coulomb friction turns, until it sticks: each
    2 Fc / K nearer to 0.
    """
    band = coulomb_n / stiffness_n_per_m
    points = [start_m]
    while abs(points[-1]) > band:
        last = points[-1]
        points.append(-last + 2.0 * band * (1.0 if last > 0.0 else -1.0))
    return points
