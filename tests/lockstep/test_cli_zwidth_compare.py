"""`zwidth compare`: displays beside each other by what `report` wrote; what is not comparable
is refused by name.
"""

import json

import pytest
from support.tree import ROOT

from hapticd.cli.app import main
from hapticd.core.errors import AnalysisError, ConfigError
from hapticd.zwidth.portable import compare

pytest.importorskip("matplotlib")

SUMMARY = ROOT / "tests/support/data/weir2008.zwidth"


def changed(path, factor=1.0, device="B", **conditions):
    """The summary of a display that is `factor` times as large: two bolted together are 2."""
    content = json.loads(SUMMARY.read_text())
    content["device"] = device
    content["conditions"] |= {
        "mass_kg": 0.008 * factor,
        "probe_mass_kg": 0.003 * factor,
        **conditions,
    }
    content["conditions"]["perturbation"]["psd_n2_per_hz"] *= factor**2
    for drawn in content["envelopes"]:
        for edge in ("upper", "lower"):
            drawn["envelope"][edge]["value"] = [
                factor * value for value in drawn["envelope"][edge]["value"]
            ]
    for limit in content["limits"]:
        limit["value"] *= factor
    path.write_text(json.dumps(content))
    return path


def test_two_displays_bolted_together_are_no_better_one(tmp_path):
    one, two = compare([changed(tmp_path / "a", device="A"), changed(tmp_path / "b", 2.0)]).displays
    for single, pair in zip(one.levels, two.levels, strict=True):
        assert pair.envelope.upper.value == pytest.approx(2.0 * single.envelope.upper.value)
        assert pair.per_mass.upper.value == pytest.approx(single.per_mass.upper.value)
        for small, large in zip(single.limits, pair.limits, strict=True):
            assert large.value == pytest.approx(2.0 * small.value)
            assert large.per_mass == pytest.approx(small.per_mass)


@pytest.mark.parametrize(
    ("conditions", "named"),
    [
        ({"seconds": 90.0}, "seconds: 10.0 and 90.0"),
        ({"band_hz": [2.0, 400.0]}, r"band_hz: \(2.0, 500.0\) and \(2.0, 400.0\)"),
        (
            {"judged": {"first_hz": 2.0, "last_hz": 480.0}},
            r"judged_hz: \(2.0, 500.0\) and \(2.0, 480.0\)",
        ),
        ({"confidence": 0.99}, "confidence: 0.95 and 0.99"),
        (
            {"perturbation": {"psd_n2_per_hz": 1e-4}},
            "perturbation_psd_n2_per_hz: 2.5e-05 and 0.0001",
        ),
    ],
)
def test_unlike_conditions_are_refused_by_name_or_named_with_the_result(
    conditions, named, tmp_path
):
    files = [changed(tmp_path / "a", device="A"), changed(tmp_path / "b", **conditions)]
    with pytest.raises(AnalysisError, match=named):
        compare(files)
    name = named.partition(":")[0]
    found = compare(files, [name, "judged_hz"])
    assert name in found.unlike


def test_same_force_on_displays_of_other_masses_is_comparable(tmp_path):
    files = [changed(tmp_path / "a", device="A"), changed(tmp_path / "b", mass_kg=0.05)]
    assert compare(files).unlike == ()


def test_comparison_is_one_object_of_json(tmp_path, capsys):
    files = [str(changed(tmp_path / name, device=name)) for name in "AB"]
    assert main(["zwidth", "compare", *files, "--json", "--no-plot"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in told["displays"]] == ["A", "B"]
    assert [limit["name"] for limit in told["displays"][0]["levels"][0]["limits"]] == [
        "K",
        "B",
        "M",
    ]
    assert told["unlike"] == told["figures"] == []


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        "3",
        '{"zwidth": 1}',
        '{"zwidth": 1, "conditions": 3, "envelopes": []}',
        '{"zwidth": 1, "envelopes": [{}]}',
    ],
)
def test_file_that_is_no_whole_summary_is_refused(content, tmp_path):
    (tmp_path / "a").write_text(content)
    with pytest.raises(ConfigError, match="Z-width summary"):
        compare([SUMMARY, tmp_path / "a"])


def test_one_display_is_no_comparison():
    with pytest.raises(AnalysisError, match="one display is not a comparison"):
        compare([SUMMARY])
    with pytest.raises(
        AnalysisError, match="--allow colour: no such condition; known: device, mass_kg"
    ):
        compare([SUMMARY, SUMMARY], ["colour"])
