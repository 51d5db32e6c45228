"""Envelope, passive set, metrics, and the fair comparison of displays."""

import dataclasses
import re

import numpy as np
import pytest
from analysis_devices import display, rigid
from spectral_trials import exact_trial, mass_damper

from hapticd.analysis.compare import (
    EnvelopeConditions,
    check_alike,
    differences,
    normalised,
    stiffness_at,
    stiffness_damping_area,
    stiffness_rate,
    width_db,
    widths_db,
    zero_mass_bandwidth_hz,
)
from hapticd.analysis.envelope import (
    EnvelopeTrial,
    accepted,
    admittance,
    envelope,
    of_trial,
    widened,
)
from hapticd.analysis.findings import Finding
from hapticd.analysis.impedance import impedance
from hapticd.analysis.linearise import Perturbation
from hapticd.analysis.passive_set import (
    axis_limit,
    grid,
    open_ends,
    passive_set,
    set_limits,
    volume,
)
from hapticd.analysis.predict import predict, predicted_impedance
from hapticd.analysis.verdict import LOST_EDGE, judge
from hapticd.errors import AnalysisError


def trial(name, z, coherence=0.99, estimator="h_force"):
    spectra = exact_trial(z, coherence)
    return EnvelopeTrial(
        name, (0.0, 0.0, 0.0), impedance(spectra, estimator), judge(spectra, channels=False)
    )


SOFT = trial("soft", mass_damper(0.008, 1.0))
FIRM = trial("firm", mass_damper(0.004, 6.0), 0.9)
ACTIVE = trial("active", lambda f: mass_damper(0.02, 0.0)(f) - 9.0)


def test_envelope_is_the_extreme_of_the_passive_trials():
    found = envelope([SOFT, ACTIVE, FIRM])
    f = SOFT.impedance.frequency_hz
    sizes = np.abs([SOFT.impedance.impedance_ns_per_m, FIRM.impedance.impedance_ns_per_m])
    assert found.trials == ("soft", "firm")
    assert found.upper.value == pytest.approx(sizes.max(axis=0))
    assert found.lower.value == pytest.approx(sizes.min(axis=0))
    crossing = np.sqrt(35.0 / (0.008**2 - 0.004**2)) / (2 * np.pi)
    assert found.owner(found.upper)[10] == "firm"
    assert np.array_equal(found.upper.owner == 0, f > crossing)
    assert found.phase_upper.value == pytest.approx(
        np.maximum(SOFT.impedance.phase_deg, FIRM.impedance.phase_deg)
    )


def test_uncertainty_is_that_of_the_owner():
    found = envelope([SOFT, FIRM])
    expected = np.where(
        found.upper.owner == 0, SOFT.impedance.relative_sd, FIRM.impedance.relative_sd
    )
    assert found.upper.sd == pytest.approx(expected)
    phase = np.where(
        found.phase_lower.owner == 0, SOFT.impedance.relative_sd, FIRM.impedance.relative_sd
    )
    assert found.phase_lower.sd == pytest.approx(np.degrees(phase))


def test_order_of_trials_changes_names_alone():
    one = envelope([SOFT, FIRM])
    other = envelope([FIRM, SOFT])
    assert one.upper.value == pytest.approx(other.upper.value)
    assert one.owner(one.upper) == other.owner(other.upper)


def test_envelope_may_grow_trial_by_trial():
    grown = widened(of_trial(SOFT), FIRM)
    assert grown.upper.value == pytest.approx(envelope([SOFT, FIRM]).upper.value)
    assert of_trial(SOFT).width_db() == pytest.approx(0.0)


def test_admittance_envelope_is_the_inverse_turned_over():
    found = envelope([SOFT, FIRM])
    inverse = admittance(found)
    assert inverse.kind == "admittance"
    assert inverse.upper.value == pytest.approx(1.0 / found.lower.value)
    assert inverse.owner(inverse.upper) == found.owner(found.lower)
    assert inverse.phase_upper.value == pytest.approx(-found.phase_lower.value)
    assert inverse.width_db() == pytest.approx(found.width_db())
    assert admittance(inverse).upper.value == pytest.approx(found.upper.value)


def test_plain_rule_accepts_what_is_undecided():
    thin = trial("thin", mass_damper(0.008, 0.05), 0.9)
    assert thin.verdict.answer == "undecided"
    assert accepted(thin.verdict, "within_90_deg")
    assert not accepted(thin.verdict, "judged")
    assert not accepted(dataclasses.replace(thin.verdict, stability="unstable"), "within_90_deg")


def test_plain_rule_accepts_no_trial_that_lost_an_edge_of_its_band():
    """What was not looked at did not pass."""
    thin = trial("thin", mass_damper(0.008, 0.05), 0.9)
    lost = Finding(LOST_EDGE, "the edge at 2.00 Hz is lost under a drift")
    assert not accepted(dataclasses.replace(thin.verdict, findings=(lost,)), "within_90_deg")


def test_values_that_are_not_known_own_nothing():
    holed = FIRM.impedance.impedance_ns_per_m.copy()
    holed[5] = np.nan
    found = widened(
        of_trial(SOFT),
        dataclasses.replace(
            FIRM, impedance=dataclasses.replace(FIRM.impedance, impedance_ns_per_m=holed)
        ),
    )
    assert found.upper.owner[5] == 0
    assert found.upper.owner[6] == 1


@pytest.mark.parametrize(
    ("trials", "message"),
    [
        ([ACTIVE], "no passive trial: there is no envelope to draw; begin with K = B = M = 0"),
        (
            [SOFT, trial("other", mass_damper(), estimator="spa")],
            "at the probe by 'spa' beside others at the probe by 'h_force'",
        ),
        (
            [SOFT, dataclasses.replace(FIRM, impedance=FIRM.impedance.without_mass(0.003))],
            "a trial at the device by",
        ),
    ],
)
def test_unlike_trials_are_refused(trials, message):
    with pytest.raises(AnalysisError, match=re.escape(message)):
        envelope(trials)


def test_unlike_frequencies_are_refused():
    shifted = dataclasses.replace(FIRM.impedance, frequency_hz=FIRM.impedance.frequency_hz + 0.1)
    with pytest.raises(AnalysisError, match="unlike frequencies: estimate all with one window"):
        widened(of_trial(SOFT), dataclasses.replace(FIRM, impedance=shifted))
    with pytest.raises(AnalysisError, match="an admittance envelope cannot be widened"):
        widened(admittance(of_trial(SOFT)), FIRM)


# --- the passive set ------------------------------------------------------------------------------

AXES = (np.linspace(0, 1000, 21), np.linspace(-2, 6, 17), np.linspace(-0.02, 0.02, 9))


def wedge(points):
    """Passive where K/1000 + |B - 1|/3 + |M|/0.01 <= 0.8."""
    k, b, m = points.T
    return 0.8 - k / 1000 - np.abs(b - 1.0) / 3 - np.abs(m) / 0.01


SET = passive_set(AXES, wedge(grid(AXES)))


def test_set_limits_are_extremes_over_all():
    found = set_limits(SET)
    assert found.stiffness == (0.0, 800.0)
    assert found.damping == (-1.0, 3.0)
    assert found.mass == pytest.approx((-0.005, 0.005))


def test_open_ends_are_where_the_grid_cuts_the_set():
    k, b, m = AXES
    for axes, ends in (
        (AXES, ()),
        ((k[2:], b, m), ("K min",)),
        ((k[:10], b, m), ("K max",)),
        ((k, b[4:], m[:5]), ("B min", "M max")),
    ):
        assert open_ends(passive_set(axes, wedge(grid(axes)))) == ends


def test_axis_limits_differ_from_set_limits():
    """At B = 0 and not at B = 1 the axis sees less stiffness: the two readings of one headline."""
    assert axis_limit(lambda points: wedge(points) >= 0, 0, 2000.0) == pytest.approx(
        1000 * (0.8 - 1 / 3), abs=0.1
    )
    assert axis_limit(lambda points: wedge(points) >= 0, 2, -0.05) == pytest.approx(
        -0.01 * (0.8 - 1 / 3), abs=1e-5
    )
    assert set_limits(SET).stiffness[1] == 800.0


def test_axis_limit_at_its_ends():
    assert axis_limit(lambda points: np.ones(len(points), bool), 1, 5.0) == 5.0
    assert np.isnan(axis_limit(lambda points: np.zeros(len(points), bool), 1, 5.0))
    assert axis_limit(
        lambda points: points[:, 1] < 2.0, 1, 5.0, base=(7.0, 1.0, 0.0)
    ) == pytest.approx(2.0, abs=1e-4)


def test_volume_of_a_pyramid():
    """Half an octahedron with K up to 800, B within 2.4 and M within 8 g of the middle: 800 x
    4.8 x 0.016 / 6.
    """
    axes = (np.linspace(0, 1000, 41), np.linspace(-2, 6, 41), np.linspace(-0.02, 0.02, 41))
    assert volume(passive_set(axes, wedge(grid(axes)))) == pytest.approx(
        800 * 4.8 * 0.016 / 6, rel=0.03
    )


def test_volume_counts_shares_of_cells():
    axes = (np.array([0.0, 1.0]),) * 3
    half = passive_set(axes, 0.5 - grid(axes)[:, 0])
    assert volume(half) == pytest.approx(0.5)
    assert volume(passive_set(axes, np.full(8, np.nan))) == 0.0


@pytest.mark.parametrize(
    ("axes", "margin", "message"),
    [
        (
            ([0.0, 1.0], [0.0, 1.0], [0.0, 1.0]),
            np.zeros(7),
            "7 margins for a grid of 2 x 2 x 2 environments",
        ),
        (
            ([0.0], [0.0, 1.0], [0.0, 1.0]),
            np.zeros(4),
            "at least two ascending values on each of its three axes",
        ),
        (([1.0, 0.0], [0.0, 1.0], [0.0, 1.0]), np.zeros(8), "at least two ascending values"),
    ],
)
def test_grid_that_is_none_is_refused(axes, margin, message):
    with pytest.raises(AnalysisError, match=re.escape(message)):
        passive_set(axes, margin)


def test_empty_set_has_no_limits():
    with pytest.raises(AnalysisError, match="no environment of the grid is passive"):
        set_limits(passive_set(AXES, -np.ones(SET.margin.size)))


def test_prediction_fills_a_set():
    axes = (np.linspace(0, 200, 9), np.linspace(-1, 4, 6), np.linspace(-0.01, 0.01, 5))
    found = predict(display(), grid(axes), perturbation=Perturbation())
    filled = passive_set(axes, found.decided_margin)
    assert np.array_equal(filled.passive.ravel(), found.passive)


# --- metrics --------------------------------------------------------------------------------------


def test_width_is_the_ratio_of_the_edges_in_decibels():
    one = trial("a", lambda f: 2.0 + 0j * f)
    other = trial("b", lambda f: 20.0 + 0j * f)
    found = envelope([one, other])
    assert width_db(found, 5.0, 50.0) == pytest.approx(20.0)
    assert [band.width_db for band in widths_db(found)] == pytest.approx([20.0] * 4)


def test_width_is_a_mean_over_the_logarithm_of_frequency():
    slope = envelope([trial("a", lambda f: 1.0 + 0j * f), trial("b", lambda f: f + 0j)])
    inside = slope.frequency_hz[(slope.frequency_hz >= 10.0) & (slope.frequency_hz <= 1000.0)]
    assert width_db(slope, 10.0, 1000.0) == pytest.approx(
        10.0 * np.log10(inside[0] * inside[-1]), rel=2e-3
    )


def test_width_outside_the_envelope_is_refused():
    with pytest.raises(AnalysisError, match=re.escape("no two frequencies in 3000..4000 Hz")):
        width_db(of_trial(SOFT), 3000.0, 4000.0)


def test_stiffness_damping_area_of_the_wedge():
    """From B = 0 to 3.4 under 800 - 1000 |B - 1| / 3 at M = 0: (467 + 800)/2 + 800 x 2.4 / 2."""
    assert stiffness_damping_area(SET) == pytest.approx((466.7 + 800) / 2 + 960, rel=0.01)


def test_stiffness_at_a_damping_and_its_rate():
    assert stiffness_at(SET, 2.0) == pytest.approx(1000 * (0.8 - 1 / 3), rel=1e-6)
    assert stiffness_rate(SET, 2.0) == pytest.approx(-1000 / 3, rel=1e-6)
    assert stiffness_rate(SET, 0.0) == pytest.approx(1000 / 3, rel=1e-6)
    assert np.isnan(stiffness_at(SET, 5.0))
    with pytest.raises(
        AnalysisError, match=re.escape("damping 9 N s/m lies outside the grid -2..6")
    ):
        stiffness_at(SET, 9.0)
    with pytest.raises(
        AnalysisError, match=re.escape("no virtual mass 0.001 kg; the nearest is 0 kg")
    ):
        stiffness_at(SET, 1.0, 0.001)


def test_zero_mass_bandwidth_of_mass_and_damper():
    f = np.geomspace(1.0, 1000.0, 4000)
    assert zero_mass_bandwidth_hz(f, mass_damper(0.008, 1.0)(f)) == pytest.approx(
        1.0 / (2 * np.pi * 0.008), rel=3e-3
    )
    assert zero_mass_bandwidth_hz(f, np.full(f.size, 2.0 + 0j)) == np.inf


# --- two displays bolted together -----------------------------------------------------------------


def measured(scale):
    """Envelope and set of so many displays, each perturbed alike, as the prediction sees them."""
    model = display(scale=scale)
    push = Perturbation(scale**2 * 2.5e-5, 1700.0)
    f = np.geomspace(2.0, 500.0, 60)
    edges = []
    for point in ((0, 0, 0), (60, 1, 0), (0, 2, 0), (0, 0, -0.005)):
        z = predicted_impedance(model, scale * np.array(point), f, perturbation=push)
        exact = dataclasses.replace(
            SOFT.impedance,
            frequency_hz=f,
            impedance_ns_per_m=z,
            sd_ns_per_m=np.zeros(60),
            coherence=np.ones(60),
            noise=z.real,
            noise_sd=z.real,
        )
        edges.append(EnvelopeTrial(str(point), point, exact, SOFT.verdict))
    axes = tuple(
        scale * axis
        for axis in (np.linspace(0, 300, 13), np.linspace(-1, 5, 13), np.linspace(-0.01, 0.01, 9))
    )
    found = passive_set(axes, predict(model, grid(axes), perturbation=push).decided_margin)
    conditions = EnvelopeConditions(
        f"{scale:g} displays",
        scale * 0.008,
        probe_mass_kg=scale * 0.003,
        perturbation_psd_n2_per_hz=push.psd_n2_per_hz,
    )
    return conditions, envelope(edges), found


def test_two_displays_bolted_together_are_no_better_display():
    """The paper's paradox: K, B and M double, so does every stiffness-damping plot; per mass
    nothing has changed.
    """
    (one, single, small), (two, double, large) = measured(1.0), measured(2.0)
    for mine, other in zip(
        dataclasses.astuple(set_limits(small)), dataclasses.astuple(set_limits(large)), strict=True
    ):
        assert other == pytest.approx(tuple(2.0 * value for value in mine))
    assert double.upper.value == pytest.approx(2.0 * single.upper.value, rel=1e-6)
    assert double.lower.value == pytest.approx(2.0 * single.lower.value, rel=1e-6)
    assert stiffness_damping_area(large) == pytest.approx(
        4.0 * stiffness_damping_area(small), rel=1e-3
    )
    assert volume(large) == pytest.approx(8.0 * volume(small), rel=0.01)
    assert double.width_db() == pytest.approx(single.width_db(), abs=1e-5)
    assert check_alike([one, two]) == ()
    a = normalised(single, one.mass_kg)
    b = normalised(double, two.mass_kg)
    assert b.upper.value == pytest.approx(a.upper.value, rel=1e-6)
    assert b.lower.value == pytest.approx(a.lower.value, rel=1e-6)


def test_normalised_admittance_is_that_of_the_normalised_impedance():
    found = envelope([SOFT, FIRM])
    assert normalised(admittance(found), 0.008).upper.value == pytest.approx(
        admittance(normalised(found, 0.008)).upper.value
    )
    with pytest.raises(
        AnalysisError,
        match=re.escape("mass 0.0 kg: the mass that moves at the port must be positive"),
    ):
        normalised(found, 0.0)


ONE = EnvelopeConditions("A", 0.008, probe_mass_kg=0.003, perturbation_psd_n2_per_hz=2.5e-5)


def test_unlike_conditions_are_refused_and_named():
    other = dataclasses.replace(ONE, device="B", grip="hand", rate_hz=2000.0)
    assert differences(ONE, other) == ("rate_hz", "grip")
    message = (
        "A and B were measured under unlike conditions: rate_hz: 1000.0 and 2000.0; grip: 'free'"
        " and 'hand'; measure them alike"
    )
    with pytest.raises(AnalysisError, match=re.escape(message)):
        check_alike([ONE, other])
    assert check_alike([ONE, other], allow=("grip", "rate_hz")) == ("rate_hz", "grip")
    with pytest.raises(AnalysisError, match="allow grip"):
        check_alike([ONE, other], allow=("rate_hz",))


def test_conditions_that_scale_with_mass_are_compared_per_mass():
    assert differences(ONE, dataclasses.replace(ONE, device="B", mass_kg=0.016)) == (
        "probe_mass_kg",
        "perturbation_psd_n2_per_hz",
    )
    doubled = EnvelopeConditions("B", 0.016, probe_mass_kg=0.006, perturbation_psd_n2_per_hz=1e-4)
    assert differences(ONE, doubled) == ()
    assert rigid(scale=2.0).mass_kg == pytest.approx(0.016)
