"""`hapticd zwidth`: what a person types, gets printed, and finds in the run folder; slips are
named and nothing is started.
"""

import json
from concurrent.futures import Executor

import numpy as np
import pytest
from support.cli_zwidth import OUTCOME, SHORT, run, small_map, trials
from support.measured_scenes import GRID_OF_27


def test_trial_prints_a_sentence_and_keeps_a_run(tmp_path, capsys):
    code, out, _ = run(
        ["trial", *SHORT, "--out", str(tmp_path / "a"), "--plot", "-K", "50", "-B", "1"], capsys
    )
    assert code == 0
    assert out.startswith(
        "SIMULATED engine, scene fig4: K 50 N/m, B 1 N s/m, M 0 kg, active damping 0 N s/m\n"
    )
    assert "in band [2, 500] Hz at 95 % confidence; stable as far as seen" in out
    assert {path.name for path in (tmp_path / "a").iterdir()} >= {
        "run.json",
        "trial.png",
        "trial.svg",
        "trial.pdf",
    }
    kept = json.loads((tmp_path / "a" / "run.json").read_text())
    assert kept["simulated"] is True
    assert kept["provenance"]["hapticd"]
    assert len(kept["scene_hash"]) == 64


def test_import_makes_a_run_of_any_record(tmp_path, capsys):
    force = np.random.default_rng(1).normal(0.0, 0.2, 80_000)
    np.savetxt(
        tmp_path / "x.csv",
        np.column_stack((force, force / 3.0)),
        delimiter=",",
        header="force,velocity",
        comments="",
    )
    words = [
        "import",
        str(tmp_path / "x.csv"),
        "--rate-hz",
        "4000",
        "--out",
        str(tmp_path / "run"),
        "-B",
        "3",
    ]
    code, out, _ = run(words, capsys)
    assert code == 0
    assert out.startswith("x.csv: K 0 N/m, B 3 N s/m")
    code, out, _ = run(["report", str(tmp_path / "run")], capsys)
    assert code == 0
    assert (tmp_path / "run" / "trial.png").is_file()


def test_limits_table_names_its_conditions(tmp_path, capsys):
    words = [
        "limits",
        *SHORT,
        "--axis",
        "B",
        "--active-damping",
        "0",
        "--amplitudes",
        "2",
        "--out",
        str(tmp_path),
    ]
    code, out, _ = run(words, capsys)
    assert code == 0
    assert out.splitlines()[0] == "SIMULATED weir2008: axis limits, the other two being 0"
    assert "not passive from" in out.splitlines()[1]
    assert "not passive from: by the interval" in out
    assert "2.5e-05" in out
    assert "0.0001" in out
    kept = json.loads((tmp_path / "run.json").read_text())
    assert [limit["name"] for limit in kept["limits"]] == ["B", "B"]
    assert (tmp_path / "limits.svg").is_file()


def test_map_goes_on_and_is_drawn_again(tmp_path, capsys):
    words = [
        "map",
        *SHORT,
        "--out",
        str(tmp_path),
        "--active-damping",
        "1.74",
        *GRID_OF_27,
    ]
    code, out, err = run(words, capsys)
    assert code == 0
    assert "27 points predicted" in err
    assert "unlike predicted: trials that came out otherwise" in out
    made = int(out.split(" trials made")[0].rsplit("\n", 1)[-1])
    assert made > 0
    code, again, _ = run(words, capsys)
    assert code == 0
    assert "0 trials made" in again
    (tmp_path / "set.png").unlink()
    assert run(["report", str(tmp_path)], capsys)[0] == 0
    assert (tmp_path / "set.png").is_file()


def test_limits_tell_outcomes_with_their_limit(tmp_path, capsys):
    words = [
        "limits",
        *SHORT,
        "--axis",
        "BM",
        "--active-damping",
        "0",
        "--amplitudes",
        "2",
        "--seed",
        "4",
        "--no-plot",
        "--json",
    ]
    code, out, _ = run([*words, "--out", str(tmp_path)], capsys)
    *outcomes, last = map(json.loads, out.splitlines())
    assert code == 0
    assert last["ok"] is True
    told = [(outcome["limit"], outcome["amplitude"]) for outcome in outcomes]
    assert {limit: told.count(limit) for limit in set(told)} == {
        (limit["name"], limit["scan"]["amplitude"]): limit["trials"] for limit in last["limits"]
    }
    assert {outcome["seed"] for outcome in outcomes} == {4}
    assert all(set(outcome) == OUTCOME | {"limit", "amplitude", "seed"} for outcome in outcomes)


def test_search_tells_outcomes_and_runs_where_it_is_told(tmp_path, capsys, monkeypatch):
    from hapticd.zwidth import search
    from hapticd.zwidth.outcomes import run_trials

    pools = []

    def searched(plan, store, tell, pool, hear):
        pools.append(pool)
        hear(
            run_trials(
                plan.params.conditions, plan.params.active_damping_ns_per_m, np.zeros((2, 3))
            )
        )
        raise KeyboardInterrupt

    monkeypatch.setattr(search, "run_search", searched)
    words = [
        "search",
        *SHORT,
        "--active-damping",
        "1.74",
        "--json",
        "--out",
        str(tmp_path),
        "--executor",
    ]
    for where in ("thread", "process"):
        code, out, err = run([*words, where], capsys)
        assert code == 130
        assert [set(json.loads(line)) for line in out.splitlines()] == [OUTCOME] * 2
        assert f"0 trials are kept in {tmp_path}" in err
    assert pools[0] is None
    assert isinstance(pools[1], Executor)


def test_maps_run_on_dask(tmp_path, capsys):
    distributed = pytest.importorskip("distributed")
    assert run(small_map(tmp_path / "here"), capsys)[0] == 0
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=":0"
    ) as it:
        there = ["--executor", it.scheduler_address.replace("tcp://", "dask://")]
        assert run(small_map(tmp_path / "there", *there), capsys)[0] == 0
        words = ["limits", *SHORT, "--axis", "B", "--active-damping", "0", "--no-plot", "--json"]
        for place, more in (("ours", []), ("theirs", there)):
            assert run([*words, *more, "--out", str(tmp_path / place)], capsys)[0] == 0
    assert trials(tmp_path / "there") == trials(tmp_path / "here")
    assert trials(tmp_path / "theirs") == trials(tmp_path / "ours")


def test_search_reports_its_doubt(tmp_path, capsys):
    code, out, err = run(
        ["search", *SHORT, "--active-damping", "1.74", "--budget", "8", "--out", str(tmp_path)],
        capsys,
    )
    assert code == 0
    (level,) = json.loads((tmp_path / "run.json").read_text())["levels"]
    assert "B min" in level["open_ends"]
    assert f"the set goes beyond the box: {', '.join(level['open_ends'])}" in err
    assert (
        "doubt: share of the volume that noise leaves open; volume of the set over K, B and M: N/m"
        " x N s/m x kg" in out
    )
    assert "miss: median difference of expected and found least Re Z" in out
    assert (tmp_path / "search.png").is_file()
    assert len((tmp_path / "trials.jsonl").read_text().splitlines()) <= 8


def test_walls_prints_the_boundary(tmp_path, capsys):
    words = [
        "walls",
        "--stiffness",
        "50",
        "1600",
        "4",
        "--viscous",
        "0",
        "2",
        "2",
        "--out",
        str(tmp_path),
        "--json",
    ]
    code, out, _ = run(words, capsys)
    assert code == 0
    lines = json.loads(out)["lines"]
    assert [
        (line["active_damping_ns_per_m"], line["wall_virtual_damping_ns_per_m"]) for line in lines
    ] == [
        (0, 0),
        (0, 2),
        (1.74, 0),
        (1.74, 2),
    ]
    assert (tmp_path / "walls.png").is_file()


def test_walls_stand_with_active_damping_from_the_approach_on(tmp_path, capsys):
    """The wall is as stiff as with the level everywhere, and an impact goes farther in."""
    found = []
    for more in ([], ["--approach", "0.5"], ["--approach", "0.5", "--slew", "20"]):
        words = ["walls", "--active-damping", "1.74", "--stiffness", "400", "800", "2"]
        words += ["--viscous", "2", "3", "2", "--no-plot", "--out", str(tmp_path), "--json", *more]
        code, out, _ = run(words, capsys)
        line, _ = json.loads(out)["lines"]
        found.append((code, line["highest_n_per_m"], line["impacts"][0]["deepest_m"]))
        rule = json.loads((tmp_path / "run.json").read_text())["contact"]
        assert (rule is None) == (not more)
    everywhere, early, late = found
    assert everywhere[:2] == early[:2] == (0, 800.0)
    assert everywhere[2] < early[2] < 0.5 * late[2]


def test_report_of_a_device_has_every_figure(tmp_path, capsys, monkeypatch):
    from hapticd.zwidth import map as maps

    monkeypatch.setattr(maps, "GRID", (3, 3))
    (tmp_path / "walls.png").touch()  # of the run before
    code, out, _ = run(
        ["report", "weir2008", *SHORT, "--active-damping", "1.74", "--out", str(tmp_path)], capsys
    )
    assert code == 0
    for name in ("trial.png", "limits.png", "set.png", "envelope.png", "weir2008.zwidth"):
        assert (tmp_path / name).is_file()
        assert name in out
    assert not (tmp_path / "walls.png").exists()
    assert json.loads((tmp_path / "run.json").read_text())["kind"] == "report"


def test_envelope_is_drawn_while_trials_arrive(tmp_path, monkeypatch):
    from hapticd.cli.zwidth import map as verb
    from hapticd.settings.scene import load_scene
    from hapticd.zwidth.outcomes import Conditions, run_trials
    from hapticd.zwidth.store import write_run

    scene = load_scene("theory")
    conditions = Conditions(scene, 20.0, scene.noise)
    monkeypatch.setattr(verb, "REDRAW_S", -1.0)
    redrawn = verb._Redrawn(conditions, tmp_path, None)
    failed, passed = run_trials(conditions, 0.0, np.array([[9000.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    redrawn([failed])
    assert not list(tmp_path.iterdir())
    redrawn([passed])
    assert {path.name for path in tmp_path.iterdir()} == {
        "envelope_so_far.png",
        "envelope_so_far.svg",
        "envelope_so_far.pdf",
    }
    write_run(tmp_path, {"kind": "map"})
    assert {path.name for path in tmp_path.iterdir()} == {"run.json"}


def test_trial_in_lockstep_is_the_whole_stack(tmp_path, capsys):
    code, out, _ = run(["trial", "lockstep", "--seconds", "8", "--out", str(tmp_path)], capsys)
    assert code == 0
    assert out.startswith("SIMULATED lock-step, scene fig4")


def test_interrupted_map_says_how_to_go_on(tmp_path, capsys, monkeypatch):
    from hapticd.zwidth import map

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(map, "run_map", interrupted)
    code, _, err = run(["map", "--out", str(tmp_path / "m"), *SHORT], capsys)
    assert code == 130
    assert f"the same command with --out {tmp_path / 'm'} goes on there" in err


def test_map_tells_outcomes_as_they_arrive(tmp_path, capsys):
    code, out, _ = run(small_map(tmp_path, "--json"), capsys)
    *outcomes, last = map(json.loads, out.splitlines())
    assert code == 0
    assert [set(outcome) for outcome in outcomes] == [OUTCOME] * 27
    assert {outcome["type"] for outcome in outcomes} == {"outcome"}
    kept = {tuple(line["environment"]): line for line in map(json.loads, trials(tmp_path))}
    for outcome in outcomes:
        assert {
            name: kept[tuple(outcome["environment"])][name] for name in OUTCOME - {"type"}
        }.items() <= outcome.items()
    assert (last["ok"], last["made"], last["levels"][0]["tried"]) == (True, 27, 27)
    _, again, _ = run(small_map(tmp_path, "--json"), capsys)
    assert json.loads(again)["made"] == 0  # one line: what was kept is not told again


def test_interrupted_map_has_told_what_it_kept(tmp_path, capsys, monkeypatch):
    from hapticd.cli.zwidth import common

    def left(new):
        raise KeyboardInterrupt

    monkeypatch.setattr(common, "print_outcomes", left)
    code, _, err = run(small_map(tmp_path, "--json"), capsys)
    assert code == 130
    assert (
        f"{len(trials(tmp_path))} trials are kept in {tmp_path}; the same command with --out"
        f" {tmp_path} goes on there" in err
    )


def test_dead_workers_leave_what_is_kept(tmp_path, capsys, monkeypatch):
    from hapticd.core.errors import HapticdError
    from hapticd.zwidth import map

    assert run(small_map(tmp_path), capsys)[0] == 0

    def died(*_):
        raise HapticdError("a worker process died")

    monkeypatch.setattr(map, "run_map", died)
    code, out, err = run(small_map(tmp_path, "--json"), capsys)
    assert code == 1
    assert json.loads(out)["error"]["message"] == "a worker process died"
    assert f"27 trials are kept in {tmp_path}; the same command" in err
    assert "hapticd: a worker process died" in err
