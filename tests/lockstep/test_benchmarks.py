"""The bookkeeping of `make bench`: judging, merging, the table, and yardsticks that do the work
they claim. Nothing is timed.
"""

import importlib
import json
import re
import sys
from array import array
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from support.models import environment_tuple
from support.tree import ROOT

from benchmarks import run, targets
from benchmarks.bare import BareLoop, EmptyBoard
from benchmarks.bench_servo import read_parameters
from benchmarks.blocks import median_quantile, quantile
from benchmarks.fault_ticks import CASES
from benchmarks.figures import Figure, compared, judge, load, merge, refused, save
from benchmarks.late import fisher_p
from benchmarks.null_link import NullLink
from benchmarks.records import place
from benchmarks.stand import parameter_file, sample_phase, settings
from benchmarks.tick_c import CReference, check_same_work, compile_library
from benchmarks.tick_reference import yardstick
from benchmarks.tick_worker import own_ns
from benchmarks.worker import BenchError
from hapticd.core.environment import Environment
from hapticd.core.errors import DaemonDown
from hapticd.mailbox import layout
from hapticd.render.law import at_rest, design_coefficients, render
from hapticd.settings.build import board_params, servo_params
from hapticd.usb import codec, frames

PROMISED = {
    *(f"fault_ticks_{code}" for code in CASES),
    "thermal_delivered_pct",
    "delay_ratio",
    *(f"attack_{name}" for name in ("ticks", "violations", "under_force", "rarest")),
    *(f"wake_{name}" for name in ("p50", "p99", "stress_p99", "sleep_p50", "sleep_p99")),
    *(f"tick_{name}" for name in ("p50_ratio", "p99_ratio", "c_ratio")),
    *(f"late_{rate}khz" for rate in (1, 2, 4, 8)),
    "late_free_hz",
    *(
        "usb_pair_ratio",
        "board_tick_ratio",
        "set_p50_ms",
        "set_p99_ms",
        "telemetry_gaps",
        "gateway_cpu_ratio",
        "guard_cpu_ratio",
        "page_cpu_ratio",
        "toggle_ratio",
        "first_paint_ratio",
    ),
    *(
        "lockstep_ratio",
        "lockstep_weir_ratio",
        "servo_rss_mb",
        "servo_growth_kb",
        "servo_threads",
        "servo_minor_faults",
    ),
    *(
        "record_cpu_ratio",
        "record_bytes_ratio",
        "replay_speed",
        "engine_rss_mb",
        "spa_scipy",
        "spa_fftw",
    ),
    *("engine_c_f32", "engine_c_f64", "engine_numba_scalar", "engine_mujoco", "engine_solve_ivp"),
    *("effects_friction_off", "effects_plant_only", "executor_process", "executor_dask"),
    "timing_stiffness_ratio",
    *(
        "trials_1000_c",
        "trials_weir_1_c",
        "trials_weir_4_c",
        "fused_c",
        "map_6384_c",
        "predict_map_ratio",
    ),
    *(
        "search_nonaffine",
        "search_affine",
        "search_weir_wrong_share",
        "search_weir_trials",
        "search_weir_grid_trials",
    ),
}
TIMES = re.compile(r"_(us|ms|s|pct)$")
# judged by its echo; no time, but a share of damping and force on virtual time
JUDGED_AS_THEY_ARE = {"set_p99_ms", "thermal_delivered_pct"}
ROWS = [(name, row) for rows in targets.TABLE.values() for name, row in rows.items()]


@pytest.mark.parametrize(
    ("target", "value", "ratio", "ok"),
    [
        ("<= 8", 8.0, None, True),
        ("<= 8", 8.001, 0.1, False),
        ("<= 1.25x", 99.0, 1.25, True),
        ("<= 1.25x", 0.0, 1.26, False),
        (">= 30x", 0.0, 30.0, True),
        (">= 30x", 99.0, 29.9, False),
        ("<= 0", 0, None, True),
        ("<= 8", None, None, False),
        ("<= 2x", 1.0, None, False),
        ("<= 8", float("nan"), None, False),
        ("", 8.0, 2.0, None),
    ],
)
def test_targets_judge_value_or_ratio(target: str, value: Any, ratio: Any, ok: bool | None) -> None:
    assert judge(target, value, ratio) is ok


def test_unreadable_target_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"target 'about 8': write '<= 25', '<= 1\.25x', '>= 30x' or 'p >= 0\.01'"
    ):
        judge("about 8", 8.0, None)


def test_ratio_is_ours_over_reference() -> None:
    figure = compared("a", "<= 2x", 3.0, "us", 2.0)
    assert figure == Figure("a", 3.0, "us", 2.0, 1.5, "<= 2x", True)


def test_speed_up_is_given_by_the_caller() -> None:
    assert compared("a", ">= 30x", 0.1, "s", 4.0, ratio=40.0) == Figure(
        "a", 0.1, "s", 4.0, 40.0, ">= 30x", True
    )


def test_zero_reference_gives_no_ratio() -> None:
    assert compared("a", "<= 2x", 3.0, "us", 0.0).ratio is None


def test_rows_have_the_promised_keys() -> None:
    keys = ["name", "value", "unit", "reference", "ratio", "target", "ok", "yardstick", "reason"]
    assert list(compared("a", "<= 2", 1.0, "s").plain()) == keys
    assert set(refused("a", "<= 2", "no tool: `make deps`").plain()) == {*keys, "note"}
    assert set(compared("a", "p >= 0.01", 1.0, "ticks", p=0.5).plain()) == {*keys, "p"}


def test_refused_figure_is_not_ok() -> None:
    assert refused("a", "<= 2", "no tool").plain() | {"note": ""} == {
        "name": "a",
        "value": None,
        "unit": "",
        "reference": None,
        "ratio": None,
        "target": "<= 2",
        "ok": False,
        "note": "",
        "yardstick": "",
        "reason": "",
    }


def test_merge_replaces_in_place() -> None:
    old = [{"name": "a", "value": 1}, {"name": "b", "value": 2}]
    new = [{"name": "c", "value": 3}, {"name": "a", "value": 4}]
    assert merge(old, new) == [
        {"name": "a", "value": 4},
        {"name": "b", "value": 2},
        {"name": "c", "value": 3},
    ]


def test_saved_rows_are_loaded(tmp_path: Path) -> None:
    rows = [compared("a", "<= 2", 1.0, "s").plain()]
    save(tmp_path / "build" / "bench.json", rows)
    assert load(tmp_path / "build" / "bench.json") == rows
    assert [path.name for path in (tmp_path / "build").iterdir()] == ["bench.json"]


@pytest.mark.parametrize("content", ["", "{", '{"a": 1}', "[1, 2]"])
def test_foreign_file_counts_as_empty(tmp_path: Path, content: str) -> None:
    (tmp_path / "bench.json").write_text(content)
    assert load(tmp_path / "bench.json") == []
    assert load(tmp_path / "missing.json") == []


def test_every_promised_name_is_measured() -> None:
    measured = [
        name for part in run.PARTS for name in importlib.import_module(f"benchmarks.{part}").TARGETS
    ]
    assert len(measured) == len(set(measured))
    assert set(measured) >= PROMISED
    assert measured == [name for name, _ in ROWS]


def test_page_repeats_the_table() -> None:
    page = (ROOT / "docs" / "development" / "benchmarks.md").read_text()
    assert targets.page() in page  # python benchmarks/run.py --page


@pytest.mark.parametrize(("name", "row"), ROWS)
def test_every_target_says_what_it_is_judged_by(name: str, row: targets.Target) -> None:
    assert row.reason
    if name != "set_p99_ms":  # whose limit is a number only when its echo was measured
        judge(row.limit, 1.0, 1.0, 1.0)  # ValueError where it cannot be read
    if row.limit.endswith("x") or row.limit.startswith("p"):
        assert row.yardstick
    if TIMES.search(name) and name not in JUDGED_AS_THEY_ARE:
        assert not row.limit, f"{name} is a time: judge it by a yardstick of the same run"


@pytest.mark.parametrize(
    ("name", "row"), [(name, row) for name, row in ROWS if row.limit.endswith("x")]
)
def test_slowed_down_subject_misses(name: str, row: targets.Target) -> None:
    """Whatever the machine's speed: a subject that just passes, made a third slower against its
    yardstick, does not pass.
    """
    limit = float(row.limit.split()[1].rstrip("x"))
    for machine in (1.0, 0.1, 7.0):
        if row.limit.startswith("<="):
            passing, slowed = (
                compared(name, row.limit, factor * limit * machine, "s", machine)
                for factor in (0.99, 1.34)
            )
        else:
            passing, slowed = (
                compared(name, row.limit, limit * machine / factor, "s", machine)
                for factor in (0.99, 1.34)
            )
        assert (passing.ok, slowed.ok) == (True, False)


def test_rare_events_are_judged_by_chance() -> None:
    """Fisher's exact test in closed form: all of n events on one of two equal sides has the
    probability of n draws.
    """
    assert fisher_p(0, 120_000, 0, 120_000) == 1.0
    assert fisher_p(3, 120_000, 0, 120_000) == pytest.approx(0.5**3, rel=1e-4)
    assert judge("p >= 0.01", 30, None, fisher_p(30, 120_000, 25, 120_000)) is True
    assert judge("p >= 0.01", 60, None, fisher_p(60, 120_000, 25, 120_000)) is False
    assert judge("p >= 0.01", 7, None, fisher_p(7, 120_000, 0, 120_000)) is False
    assert judge("p >= 0.01", 0, None, fisher_p(0, 120_000, 50, 120_000)) is True


def test_explained_rows_carry_yardstick_and_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def measure() -> Any:
        yield compared("spa_fftw", "<= 2x", 1.0, "ms", 1.0)

    monkeypatch.setitem(
        sys.modules, "benchmarks.spa", SimpleNamespace(TARGETS=targets.of("spa"), measure=measure)
    )
    scipy, fftw = run.measure("spa")
    assert (fftw.yardstick, fftw.reason) == (
        targets.TABLE["spa"]["spa_fftw"].yardstick,
        targets.TABLE["spa"]["spa_fftw"].reason,
    )
    assert scipy.note == "not measured"
    assert scipy.reason


def test_repeated_runs_show_the_worst(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = iter([(1.0, 40.0), (1.2, 36.0), (1.1, 39.0)])

    def measure(_part: str) -> list[Figure]:
        slow, fast = next(found)
        return [
            compared("slow", "<= 2x", slow, "s", 1.0),
            compared("fast", ">= 30x", fast, "s", 1.0),
        ]

    monkeypatch.setattr(run, "measure", measure)
    run.main(["--only", "spa", "--repeat", "3", "--output", str(tmp_path / "bench.json")])
    printed = capsys.readouterr().out
    assert re.search(r"slow .* 1 1\.2 1\.1 .* 1\.2 .* 1\.56 ", printed)
    assert re.search(r"fast .* 40 36 39 .* 36 .* 27\.69 ", printed)


def test_empty_board_answers_every_write() -> None:
    stand = settings()
    board = board_params(stand)
    assert board is not None
    port = EmptyBoard(board)
    assert codec.decode_in(port.poll_in(0) or b"").status == frames.StatusBit.SIMULATED
    assert (
        BareLoop(servo_params(stand, "bench").usb, board, yardstick(Environment(), 1000.0)).cpu_s(
            20
        )
        > 0.0
    )


def test_only_takes_commas_and_blanks() -> None:
    assert run.chosen("wake,tick") == run.chosen(" wake tick ") == ["wake", "tick"]
    assert run.chosen("") == [part for part in run.PARTS if part not in run.BY_NAME]
    assert run.chosen("guard_attack") == ["guard_attack"]
    assert set(run.PARTS) > run.BY_NAME
    assert run.chosen("new") == [part for part in run.PARTS if part in run.GROUPS["new"]]


def test_unknown_part_names_the_known() -> None:
    with pytest.raises(SystemExit, match="no part 'wakke'; parts: wake, tick, late"):
        run.chosen("wakke")


@pytest.mark.parametrize(
    "error",
    [BenchError("no tool: `make deps`"), DaemonDown("nobody answers"), OSError("no such file")],
)
def test_broken_part_says_why(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    def measure() -> Any:
        yield compared("first", "<= 2", 1.0, "s")
        raise error

    part = SimpleNamespace(TARGETS={"second": "<= 3x", "first": "<= 2"}, measure=measure)
    monkeypatch.setitem(sys.modules, "benchmarks.broken", part)
    assert run.measure("broken") == [
        refused("second", "<= 3x", str(error)),
        compared("first", "<= 2", 1.0, "s"),
    ]


def test_only_merges_into_the_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "bench.json"
    save(output, [{"name": "old"}, {"name": "wake_p50", "ok": False}])
    monkeypatch.setattr(
        run, "measure", lambda part: [refused("wake_p50", "<= 0.1x", f"{part} is [new]")]
    )
    assert run.main(["--only", "wake", "--output", str(output)]) == 0
    rows = json.loads(output.read_text())
    assert [row["name"] for row in rows] == ["old", "wake_p50"]
    assert rows[1]["note"] == "wake is [new]"
    printed = capsys.readouterr().out
    assert "wake_p50: wake is [new]" in printed
    assert "0 of 1 passed, 1 missed" in printed


def test_whole_run_begins_anew(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    output = tmp_path / "bench.json"
    save(output, [{"name": "old"}])
    monkeypatch.setenv("ONLY", "")
    monkeypatch.setattr(run, "measure", lambda part: [compared(part, "<= 2", 1.0, "s")])
    run.main(["--output", str(output)])
    assert [row["name"] for row in json.loads(output.read_text())] == run.chosen("")


def test_quantile_is_nearest_rank() -> None:
    assert [quantile([5, 1, 4, 2, 3], fraction) for fraction in (0.0, 0.5, 0.99, 1.0)] == [
        1,
        3,
        5,
        5,
    ]


def test_one_disturbed_block_is_one_vote() -> None:
    assert median_quantile([[1, 1], [2, 2], [900, 900]], 0.99) == 2


def test_places_follow_the_table() -> None:
    dtype = np.dtype([tuple(row) for row in layout.TELEMETRY])
    marked = np.zeros(1, dtype)
    marked["position_m"] = 1.5
    marked["excess_j"] = 2.5
    marked["publish_ns"] = 3
    marked["tail"] = 4
    record = layout.RECORD.unpack(marked.tobytes())
    assert record[place("position_m")] == 1.5
    assert record[place("excess_j")] == 2.5
    assert record[place("publish_ns")] == 3
    assert record[place("tail")] == 4
    with pytest.raises(KeyError, match="colour"):
        place("colour")


def test_c_yardstick_fills_the_same_record(tmp_path: Path) -> None:
    CReference(
        compile_library(tmp_path), servo_params(settings(), "bench")
    )  # refuses other sizes than layout.RECORD


def test_yardstick_of_other_work_is_refused() -> None:
    fields = [0] * len(layout.RECORD.unpack(bytes(layout.RECORD.size)))
    for name, size in (("plan", layout.PLAN.size), ("in_frame", 64), ("out_frame", 32)):
        fields[place(name)] = bytes(size)
    ours = layout.RECORD.pack(*fields)
    check_same_work(ours, ours)
    fields[place("force_n")] = 1e-6
    with pytest.raises(BenchError, match=r"tick_reference\.c computes .*1e-06.*; correct it"):
        check_same_work(ours, layout.RECORD.pack(*fields))
    fields[place("force_n")], fields[place("out_frame")] = 0.0, b"\1" * 32
    with pytest.raises(
        BenchError, match=r"tick_reference\.c sends 0101.*, the servo 0000.*; correct it"
    ):
        check_same_work(ours, layout.RECORD.pack(*fields))


def test_own_time_leaves_out_the_link() -> None:
    record = np.zeros(2, [tuple(row) for row in layout.TELEMETRY])
    for name, values in (
        ("read_ns", (1000, 1)),
        ("step_ns", (2000, 1)),
        ("write_ns", (500, 1)),
        ("publish_ns", (77, 300)),
    ):
        record[name] = values  # publish is that of the tick before
    assert own_ns(record.tobytes(), [200, 0], 50.0) == [1000 + 2000 + 500 + 300 - 200 - 50]


def test_null_link_frames_follow_each_other() -> None:
    with parameter_file() as path:
        link = NullLink(read_parameters(path)[1])
    buffer = array("B", bytes(frames.PACKET_BYTES))
    parse = codec.in_parser(buffer)
    heads = []
    for _ in range(2):  # the second time goes on where reading stopped, whatever lay ready
        link.prepare(5)
        for _ in range(3):
            assert link.read(buffer) == frames.IN_BYTES
            heads.append(parse())
    assert None not in heads
    assert [head[0] for head in heads] == list(range(6))
    assert [head[1] for head in heads] == list(range(1, 7))
    assert [head[5] for head in heads] == [1000 * number for number in range(1, 7)]


def test_python_yardstick_renders_the_same_force() -> None:
    params = servo_params(settings(), "bench")
    with parameter_file() as path:
        link = NullLink(read_parameters(path)[1])
    link.prepare(200)
    tick = yardstick(params.environment, 1000.0)
    state = at_rest(0.0)
    law = environment_tuple(params.environment, 8.0)
    filters = design_coefficients(
        params.environment.velocity_filter, params.environment.acceleration_filter, 1000.0
    )
    for frame in link.frames:
        x = codec.decode_in(frame.tobytes()).encoder * 0.5e-6
        force, *_, state = render(x, state, law, filters)
        torque = frames.OUT.unpack(tick(frame.tobytes(), 0))[3]
        assert abs(torque - force * 32767 / 8.0) <= 0.5 + 1e-6


@pytest.mark.parametrize(
    ("rate_hz", "phase"), [(1000, 0.875), (2000, 0.75), (4000, 0.5), (8000, 0.5)]
)
def test_board_leaves_the_host_its_time(rate_hz: float, phase: float) -> None:
    assert sample_phase(rate_hz) == phase
    assert settings(rate_hz).config.simulation.sample_phase == phase
