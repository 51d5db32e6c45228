"""Scene files and composed devices: what is shipped, what a scene may change, and what is told
when it is wrong.
"""

import re
from pathlib import Path

import pytest
from support.plant_devices import alpha

from hapticd.core.errors import ConfigError
from hapticd.model.compose import compose
from hapticd.model.effects import ALWAYS, KINDS, Coulomb, WindingTemperature
from hapticd.settings import build
from hapticd.settings.load import load
from hapticd.settings.scene import load_scene, scene_names
from hapticd.settings.toml import shipped

DEVICES = ("weir2008", "weir2008_probe_hp", "weir2008_literal", "ideal")
SCENE = 'title = "t"\ndevice = "weir2008"\neffects = ["probe", "viscous"]\n'


def scene_file(folder: Path, text: str = "", head: str = SCENE) -> Path:
    file = folder / "mine.toml"
    file.write_text(head + text)
    return file


def message(folder: Path, text: str = "", head: str = SCENE) -> str:
    with pytest.raises(ConfigError) as caught:
        load_scene(scene_file(folder, text, head))
    return str(caught.value).replace(f"{folder}/", "").replace(f"{shipped('config')}/", "")


def test_every_asked_scene_is_shipped() -> None:
    asked = {
        "fig4",
        "fig7",
        "toggle",
        "toggle_offset",
        "wall",
        "wall_inductance",
        "hot",
        "free",
        "hand",
    }
    assert asked <= set(scene_names())


@pytest.mark.parametrize("name", scene_names())
def test_shipped_scenes_compose_and_are_stable(name: str) -> None:
    scene = load_scene(name)
    model = compose(scene)
    assert model.name == scene.name == name
    assert scene.active_damping[0].at_s == 0.0
    assert scene.title
    assert {effect.key for effect in scene.effects} >= set(ALWAYS)


def test_paper_figures_are_rendered_as_printed() -> None:
    fig4 = load_scene("fig4")
    fig7 = load_scene("fig7")
    first = fig4.environment
    second = fig7.environment
    assert (first.stiffness_n_per_m, first.virtual_damping_ns_per_m, first.mass_kg) == (
        100.0,
        1.0,
        0.010,
    )
    assert (second.stiffness_n_per_m, second.virtual_damping_ns_per_m, second.mass_kg) == (
        50.0,
        2.0,
        0.0,
    )
    assert fig4.active_damping[-1].level_ns_per_m == 0.0
    assert fig7.active_damping[-1].level_ns_per_m == 1.74


@pytest.mark.parametrize("name", DEVICES)
def test_shipped_devices_build_a_live_board(tmp_path: Path, name: str) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text(f'device = "{name}"')
    settings = load(file)
    board = build.board_params(settings)
    assert board is not None
    assert board.plant is not None
    assert board.mass_kg == pytest.approx(0.008)
    assert any(level == pytest.approx(1.74, abs=1e-4) for level in board.plant.levels_ns_per_m)


def test_calibrated_device_delivers_what_is_commanded() -> None:
    """alpha = 0.945 and a gain of 1 / 0.945: 1.74 Ns/m net, and 5.5 % of the force missing."""
    model = compose(load_scene("fig7"))
    found = alpha(model.level_gain * 1.74, model.residual_ohm, model.torque_constant_n_per_a)
    assert found == pytest.approx(0.945, rel=1e-12)
    assert model.level_gain * found == pytest.approx(1.0, rel=1e-12)
    assert model.residual_ohm / 1.6 == pytest.approx(0.0537, abs=1e-4)


def test_delays_fall_on_the_grid_of_the_board(tmp_path: Path) -> None:
    file = tmp_path / "hapticd.toml"
    for name, expected in (
        ("weir2008", (0.875, 0)),
        ("weir2008_probe_hp", (0.5625, 1)),
        ("ideal", (0.875, 0)),
    ):
        file.write_text(f'device = "{name}"')
        board = build.board_params(load(file))
        assert board is not None
        assert (board.sample_phase, board.lag_periods) == expected
    file.write_text('device = "weir2008"\n[simulation]\nsample_phase = 0.5')
    board = build.board_params(load(file))
    assert board is not None
    assert (board.sample_phase, board.lag_periods) == (0.5, 0)


def test_simulation_may_build_fewer_effects(tmp_path: Path) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "weir2008"\n[simulation]\neffects = ["probe", "viscous"]')
    board = build.board_params(load(file))
    assert board is not None
    assert board.plant is not None
    assert board.plant.states == ("rotor_position", "rotor_velocity")
    file.write_text('[simulation]\neffects = ["probe"]')
    with pytest.raises(
        ConfigError,
        match=r"simulation.effects: device 'simulated display' has no \[model\] that effects",
    ):
        load(file)
    file.write_text('device = "weir2008"\n[simulation]\neffects = ["prob"]')
    with pytest.raises(
        ConfigError,
        match=(
            r"toml:3: simulation.effects = prob: is not an effect; did you mean 'probe'\?; known:"
            r" masses"
        ),
    ):
        load(file)


def test_scene_changes_single_numbers(tmp_path: Path) -> None:
    scene = load_scene(
        scene_file(
            tmp_path,
            "[model.coulomb]\nrotor_n = 0.05\n",
            SCENE.replace('"viscous"', '"coulomb", "encoder"'),
        )
    )
    coulomb = next(effect for effect in scene.effects if isinstance(effect, Coulomb))
    assert (coulomb.rotor_n, coulomb.source) == (0.05, "calibrated")
    assert compose(scene).encoder_quantum_m == 0.5e-6


def test_scene_brings_tables_the_device_has_not(tmp_path: Path) -> None:
    text = '[model.winding]\ntemperature_c = 60.0\ncompensated_c = 20.0\nsource = "inferred"\n'
    head = SCENE.replace("weir2008", "ideal").replace('"viscous"', '"viscous", "winding"')
    winding = next(
        e
        for e in load_scene(scene_file(tmp_path, text, head)).effects
        if isinstance(e, WindingTemperature)
    )
    assert winding.temperature_c == 60.0


CASES = (
    (
        "",
        "effects",
        "mine.toml:3: effects = viscos: is not an effect; did you mean 'viscous'?; known: ",
        ('"viscous"', '"viscos"'),
    ),
    ("", "twice", "mine.toml:3: effects = probe: is named twice", ('"viscous"', '"probe"')),
    (
        "",
        "always",
        "mine.toml:3: effects = masses: is always built; leave it out",
        ('"viscous"', '"masses"'),
    ),
    (
        "",
        "needs",
        "mine.toml:3: effects = heating: needs the effect 'winding'; add it",
        ('"viscous"', '"heating"'),
    ),
    (
        "",
        "table",
        (
            "mine.toml:3: effects = smoothing: device 'ideal display' has no table"
            " [model.smoothing]; add it or leave"
        ),
        ('weir2008"\neffects = ["probe", "viscous"]', 'ideal"\neffects = ["probe", "smoothing"]'),
    ),
    (
        "",
        "device",
        "mine.toml:2: device = 'weir2009': no such device file; did you mean 'weir2008'?; known: ",
        ("2008", "2009"),
    ),
    (
        "[model.coulomb]\nrotor_n = -1.0\n",
        "range",
        "mine.toml:5: model.coulomb.rotor_n = -1.0 N: must be at least 0",
        ("", ""),
    ),
    (
        "[model.coulomb]\nrotr_n = 1.0\n",
        "key",
        "mine.toml:5: model.coulomb.rotr_n: is unknown; did you mean 'rotor_n'?",
        ("", ""),
    ),
    (
        "[model.colomb]\nrotor_n = 1.0\n",
        "name",
        "mine.toml:4: model.colomb: is unknown; did you mean 'coulomb'?",
        ("", ""),
    ),
    (
        "[model.delay]\nsource = 'guess'\n",
        "tag",
        "mine.toml:5: model.delay.source = 'guess': must be 'paper'",
        ("", ""),
    ),
    ("[model.ends]\nlower_m = 0.5\n", "ends", "devices/weir2008.toml:", ("", "")),
    (
        "[model.masses]\nslider_kg = 0.0\n",
        "slider",
        "mine.toml:5: model.masses.slider_kg = 0.0 kg: must be more",
        ("", ""),
    ),
    (
        "[model.delay]\nsources = { period = 'paper' }\n",
        "sources",
        (
            "mine.toml:5: model.delay.sources = period: is not a key of this table; did you mean"
            " 'periods'?"
        ),
        ("", ""),
    ),
    (
        "[excitation]\nkind = 'nois'\n",
        "kind",
        "mine.toml:5: excitation.kind = 'nois': must be 'none', 'noise', ",
        ("", ""),
    ),
    (
        "[[active_damping]]\nat_s = 1\n",
        "step",
        "mine.toml:4: active_damping[0].level_ns_per_m: is missing; add it in N s/m",
        ("", ""),
    ),
    (
        "secnds = 3.0\n",
        "word",
        "mine.toml:4: secnds: is unknown; did you mean 'seconds'?",
        ("", ""),
    ),
)


@pytest.mark.parametrize(
    ("text", "expected", "change"), [(c[0], c[2], c[3]) for c in CASES], ids=[c[1] for c in CASES]
)
def test_message_names_line_and_remedy(
    tmp_path: Path, text: str, expected: str, change: tuple[str, str]
) -> None:
    assert message(tmp_path, text, SCENE.replace(*change, 1)).startswith(expected)


def test_unknown_scene_lists_those_known() -> None:
    with pytest.raises(
        ConfigError, match=r"^'fig5': no such scene; did you mean 'fig[47]'\?; known: .*fig4, fig7"
    ):
        load_scene("fig5")


def test_device_without_model_makes_no_scene(tmp_path: Path) -> None:
    expected = (
        "mine.toml:3: effects: device 'simulated display' has no [model] that effects could be"
        " taken from"
    )
    assert message(tmp_path, "", SCENE.replace("weir2008", "simulated")) == expected


def test_plant_and_model_exclude_each_other(tmp_path: Path) -> None:
    (tmp_path / "devices").mkdir()
    rigid = (shipped("config") / "devices" / "simulated.toml").read_text()
    whole = (shipped("config") / "devices" / "weir2008.toml").read_text()
    (tmp_path / "devices" / "both.toml").write_text(whole + "\n" + rigid[rigid.index("[plant]") :])
    (tmp_path / "hapticd.toml").write_text('device = "both"')
    with pytest.raises(
        ConfigError, match=r"both.toml:\d+: plant: is there as well as \[model\]; keep one of them"
    ):
        load(tmp_path / "hapticd.toml")


def test_every_effect_is_in_a_shipped_device_or_scale() -> None:
    text = (shipped("config") / "devices" / "weir2008.toml").read_text()
    from_scales = {"encoder", "force_dac", "damping_dac", "probe_adc", "saturation"}
    missing = {
        kind.key for kind in KINDS if not re.search(rf"^\[model\.{kind.key}\]", text, re.M)
    } - from_scales
    assert missing == {"velocity_highpass"}
