"""The device file that the netlist wrote goes through prediction, limits and guard."""

import json

from support.circuit_plant import SCENE
from support.guard_device import change, shipped_judge

from firmware_iface.hardware.device_file import NAME
from hapticd.cli.app import main


def told(capsys, *arguments):
    """The last line of `hapticd ARGUMENTS --json`."""
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out.splitlines()[-1])


def scene_file(folder):
    path = folder / "circuit.toml"
    path.write_text(SCENE.format(stiffness=500.0, virtual_damping=2.0, level=1.74))
    return str(path)


def test_it_predicts_that_k_500_b_2_is_passive_with_active_damping_alone(tmp_path, capsys):
    scene = scene_file(tmp_path)
    with_it = told(capsys, "zwidth", "predict", "--scene", scene, "--active-damping", "1.74")
    without = told(capsys, "zwidth", "predict", "--scene", scene, "--active-damping", "0")

    assert (with_it["device"], with_it["passive"]) == (NAME, True)
    assert with_it["theorem"]["passive"]
    assert without["spectral_radius"] > 1.0


def test_its_limit_of_stiffness_is_found_by_trials(tmp_path, capsys):
    found = told(
        capsys, "zwidth", "limits", "--scene", scene_file(tmp_path), "--active-damping", "1.74",
        "--axis", "K", "--seconds", "20", "--out", str(tmp_path / "run"), "--no-plot",
    )  # fmt: skip
    (limit,) = found["limits"]

    assert 300.0 < limit["value"] < 700.0


def test_the_guard_refuses_k_500_without_active_damping_and_allows_it_with_1_74():
    judge = shipped_judge(NAME)
    without = change(judge, {"K": 500.0, "B": 2.0})["verdict"]
    with_it = change(judge, {"K": 500.0, "B": 2.0, "active_damping": 1.74})["verdict"]

    assert (without["safe"], with_it["safe"]) == (False, True)
