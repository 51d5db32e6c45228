"""The paper's numbers: arithmetic, the table's schema, limits by prediction and, marked slow, by trials."""

import json
from math import isnan
from pathlib import Path

import numpy as np
import pytest

from hapticd.analysis.spa import spa
from hapticd.cli.app import main
from hapticd.measure import reproduce_limits as searches
from hapticd.measure.reproduce import ReproduceParams, ReproduceResult, plan_reproduce, run_reproduce
from hapticd.measure.reproduce_grid import POINTS, by_prediction
from hapticd.measure.reproduce_rows import PAPER, Row, arithmetic, by_quantity
from hapticd.measure.reproduce_table import rows
from hapticd.measure.reproduce_trials import BETWEEN_HZ, LEVELS, MAIN, SCENES, flown, passes, real_between, subject
from hapticd.report.paper_table import as_json, markdown, notes, paper_table

NAMES = ("K_max_off", "B_max_off", "M_min_off", "K_max_on", "B_max_on", "M_min_on")


@pytest.fixture(scope="module")
def quick() -> ReproduceResult:
    return run_reproduce(plan_reproduce(ReproduceParams(quick=True)))


@pytest.fixture(scope="module")
def table(quick: ReproduceResult) -> dict[str, dict[str, Row]]:
    return by_quantity(rows(quick))


def test_ratios_follow_from_printed_limits() -> None:
    found = {row.quantity: row for row in arithmetic(0.0165, 1.6, 0.01)}
    assert found["K_ratio_printed"].ours == pytest.approx(600 / 100)
    assert found["B_ratio_printed"].ours == pytest.approx(8 / 3)
    assert found["M_ratio_printed"].ours == pytest.approx(22 / 8)
    assert {row.kind for row in found.values()} == {"arithmetic"}


def test_equations_and_copper_by_hand() -> None:
    found = {row.quantity: row for row in arithmetic(0.0165, 1.6, 0.01)}
    assert found["K_gain_eq2"].ours == pytest.approx(2 * 1.74 / 1e-3)
    assert found["eq2_fig4_damping"].paper == pytest.approx(100 * 1e-3 / 2 + 1)
    assert found["eq3_crowbar"].ours == pytest.approx(0.0165**2 / 1.6)
    assert found["eq3_crowbar_endpoint"].ours == pytest.approx(1.70, rel=1e-9)
    assert "2.14 m" in found["eq3_crowbar_endpoint"].note
    assert found["copper_40_K"].ours == pytest.approx(15.72)


def test_every_device_has_six_limits(table: dict[str, dict[str, Row]]) -> None:
    for name in NAMES:
        assert set(table[name]) == set(SCENES)
        assert {row.paper for row in table[name].values()} == {PAPER[name]}


def test_fitted_numbers_are_called_calibrated(table: dict[str, dict[str, Row]]) -> None:
    for name in NAMES:
        kinds = {device: row.kind for device, row in table[name].items()}
        assert kinds == {"weir2008": "calibrated", "weir2008_probe_hp": "calibrated", "weir2008_literal": "independent"}
    assert table["fig8_peak_on"][MAIN].kind == "independent"


def test_predicted_limits_bracket_the_paper(table: dict[str, dict[str, Row]]) -> None:
    for name in NAMES:
        assert abs(table[name][MAIN].difference) < (0.2 if name == "K_max_off" else 0.1), name


def test_printed_numbers_alone_allow_nothing_undamped(table: dict[str, dict[str, Row]]) -> None:
    for name in NAMES[:3]:
        assert table[name]["weir2008_literal"].ours == 0.0
        assert "no friction" in table[name]["weir2008_literal"].note
    assert table["K_max_on"]["weir2008_literal"].ours == pytest.approx(2 * 1.74 / 1e-3, rel=2e-3)


def test_added_damping_is_what_was_asked(table: dict[str, dict[str, Row]]) -> None:
    for row in table["added_damping"].values():
        assert row.ours == pytest.approx(1.74, rel=1e-3)


def test_phase_turns_and_magnitude_stays(table: dict[str, dict[str, Row]]) -> None:
    assert 20.0 < table["fig7_phase_advantage"][MAIN].ours < 45.0
    assert table["fig7_magnitude_change"][MAIN].ours < 6.0
    assert table["fig4_passive"][MAIN].ours == 1.0


def test_peak_comes_from_negative_mass(table: dict[str, dict[str, Row]]) -> None:
    assert 75.0 < table["fig8_peak_on"][MAIN].ours < 110.0
    assert table["fig8_peak_mass_on"][MAIN].ours < 0.0
    assert isnan(table["fig8_peak_off"][MAIN].ours)


def test_band_edge_tells_the_explanations_apart(table: dict[str, dict[str, Row]]) -> None:
    def gain(device: str) -> float:
        return table["K_max_from_5_Hz_on"][device].ours / table["K_max_from_2_Hz_on"][device].ours

    assert gain("weir2008") < 1.1
    assert gain("weir2008_probe_hp") > 1.5


def test_grid_is_the_papers_thirteen_days() -> None:
    assert POINTS.shape == (6384, 3)
    found = by_prediction(subject(MAIN), LEVELS[1])
    assert found.limits.mass[0] == pytest.approx(-0.022)
    assert found.envelope.upper.value.min() > 0.0


def test_values_between_frequencies_are_exact() -> None:
    random = np.random.default_rng(1)
    force, velocity = random.standard_normal((2, 20_000))
    velocity[1:] += 0.5 * force[:-1]
    expected = spa(force, velocity, frequency_hz=BETWEEN_HZ).cross.real
    np.testing.assert_allclose(real_between(spa(force, velocity)), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_passive_trial_passes_and_an_escape_fails() -> None:
    kbm = np.array([[50.0, 2.0, 0.0], [0.0, 30.0, 0.0]])
    calm, wild = flown(subject(MAIN), kbm, LEVELS[1], seed=1, seconds=20.0)
    assert passes(calm)
    assert wild is None
    assert not passes(wild)


def test_limit_without_prediction_is_none() -> None:
    assert isnan(searches.simulated_limit(MAIN, 0.0, 0, (0.0, 0.0, 0.0), float("nan"), seed=1))
    assert np.isnan(searches.edge_limits(MAIN, 0.0, float("nan"), seed=1)).all()


def test_text_and_markdown_have_a_column_per_device(quick: ReproduceResult) -> None:
    found = rows(quick)
    content = paper_table(found)
    assert content.columns == ("quantity", "unit", "paper", *SCENES, "kind")
    assert markdown(content).count("\n") == len(content.rows) + 2
    assert any("2.14 m" in note for note in notes(found))


def test_json_has_null_where_nothing_is_known(quick: ReproduceResult) -> None:
    found = as_json(rows(quick))
    assert {"quantity", "paper", "ours", "unit", "kind", "device", "sd"} <= set(found[0])
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    literal = next(row for row in found if row["quantity"] == "K_ratio" and row["device"] == "weir2008_literal")
    assert literal["ours"] is None


def test_quick_verb_prints_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["zwidth", "reproduce", "--quick", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert {row["quantity"] for row in told["table"]} >= set(NAMES)
    assert told["quick"] is True
    assert "figures" not in told


def test_quick_verb_draws_the_figures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    assert main(["zwidth", "reproduce", "--quick", "--json", "--out", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    names = {Path(file).name for file in told["figures"]}
    for figure in ("fig03", "fig04", "fig07", "fig08", "fig09", "fig10", "fig11", "limits", "band_edge"):
        assert {f"{figure}.png", f"{figure}.svg"} <= names
    assert json.loads((tmp_path / "table.json").read_text())["table"] == told["table"]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_six_limits_by_trials_within_eight_percent() -> None:
    for level in LEVELS:
        for axis, name in enumerate(searches.NAMES):
            near = searches.predicted_limit(MAIN, level, axis)
            seen = [searches.simulated_limit(MAIN, level, axis, (0.0, 0.0, 0.0), near, seed) for seed in range(1, 9)]
            printed = PAPER[f"{name}_{'on' if level else 'off'}"]
            assert np.mean(seen) == pytest.approx(printed, rel=0.08), (name, level, seen)
