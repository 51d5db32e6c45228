"""The page of future work: rows with units, words from the numbers, one figure a part."""

from math import isfinite

import pytest
from support.reproduced import future_work_by_prediction

from examples.weir2008.future_page import future_sections as sections
from examples.weir2008.future_page import restored
from hapticd.zwidth.report import style


@pytest.fixture(scope="module")
def quick():
    """All of it by prediction, with fewer corners."""
    return future_work_by_prediction()


def test_negative_damping_takes_back_what_added_damping_raised(quick):
    low = {name: found.lower_db()[0] for name, found in quick.envelopes.items()}
    for kind in ("", "_safe"):
        assert low[f"off{kind}"] + 5.0 < low[f"on{kind}"]
        assert low[f"on_negative_B{kind}"] < low[f"on{kind}"] - 5.0
        upper = [quick.envelopes[f"{name}{kind}"].upper.value for name in ("on", "on_negative_B")]
        # the same environment, calculated in another batch, may round in another way
        assert (upper[1] >= upper[0] * (1.0 - 1e-12)).all()
    assert restored(quick, "_safe")[0] == pytest.approx(
        100 * (low["on_safe"] - low["on_negative_B_safe"]) / (low["on_safe"] - low["off_safe"])
    )


def test_rows_have_units_part_and_no_paper(quick):
    found = [row for section in sections(quick) for row in section.rows]
    names = [row.quantity for row in found]
    assert len(names) == len(set(names))
    assert {row.part for row in found} == {"beyond"}
    assert not any(isfinite(row.paper) for row in found)
    refused = next(row for row in found if row.quantity == "eq2_on_negative_B")
    assert "use required_damping" in refused.note
    numbers = [row for row in found if row is not refused]
    assert all(isfinite(row.ours) for row in numbers)
    assert {row.unit for row in numbers} == {
        "dB", "%", "Ns/m", "Hz", "N/m", "kg", "1", "N/m per Ns/m", "Ns/m per Ns/m", "kg per Ns/m",
    }  # fmt: skip


def test_rows_do_not_take_names_of_the_six_limits(quick):
    six = {f"{name}_{mode}" for name in ("K_max", "B_max", "M_min") for mode in ("off", "on")}
    assert not six & {row.quantity for section in sections(quick) for row in section.rows}


def test_page_tells_each_part_once_with_its_figure(quick):
    found = sections(quick)
    names = [drawing.name for section in found for drawing in section.drawings]
    assert names == ["beyond_lower_edge", "beyond_free_motion", "beyond_shaped", "beyond_levels"]
    low = quick.envelopes["on_negative_B"].lower_db()[0]
    assert f"With B < 0 it comes to {low:.1f} dB" in found[0].words
    assert "with twice the force" not in found[0].words  # nothing was flown


def test_figures_carry_units_and_say_that_they_are_simulated(quick):
    for drawing in (drawing for section in sections(quick) for drawing in section.drawings):
        with style.styled():
            figure = drawing.draw()
        labels = [axis.get_ylabel() for axis in figure.axes if axis.get_ylabel()]
        assert labels
        assert all("(" in label for label in labels)
        titles = [figure.get_suptitle(), *(axis.get_title(loc="left") for axis in figure.axes)]
        assert any("SIMULATED weir2008, predicted" in title for title in titles)
