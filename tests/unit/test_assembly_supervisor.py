"""The supervisor on virtual time with scripted processes: order of start and end, restarts,
signals, what is left behind.
"""

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from hapticd.core.errors import ConfigError, HapticdError, MailboxError
from hapticd.core.params import GatewaySetup, ServoParams, from_plain
from hapticd.core.units import NS_PER_S, VirtualClock
from hapticd.mailbox import files, layout
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.model.params import BoardParams, GuardSetup
from hapticd.run import supervisor
from hapticd.run.supervisor import ProcessEvent, Restarts, Supervisor, mailbox_served
from hapticd.settings.load import load
from hapticd.settings.toml import shipped


class ScriptedProcess:
    """A process that says ready at once (unless told otherwise), ends on SIGTERM (unless
    stubborn), dies when told.
    """

    def __init__(self, pid: int, stubborn: bool) -> None:
        self.pid = pid
        self.stubborn = stubborn
        self.code: int | None = None
        self.got: list[str] = []

    def poll(self) -> int | None:
        return self.code

    def terminate(self) -> None:
        self.got.append("TERM")
        if not self.stubborn:
            self.code = 0

    def kill(self) -> None:
        self.got.append("KILL")
        self.code = -9


class Stage:
    """A supervisor with a script: `at(seconds, action)` runs actions in virtual time."""

    def __init__(self, folder: Path, console: bool = False) -> None:
        self.clock = VirtualClock(NS_PER_S)
        self.events: list[tuple[float, ProcessEvent]] = []
        self.processes: dict[str, list[ScriptedProcess]] = {
            "servo_main": [],
            "gateway_main": [],
            "page": [],
        }
        self.on_start: Callable[[str, ScriptedProcess], None] = lambda name, process: None
        self.gateway_serves = True
        self.page_serves = True
        self.stubborn = False
        self._script: list[tuple[float, Callable[[], None]]] = []
        settings = load(shipped("config") / "hapticd.toml")
        self.supervisor = Supervisor(
            folder,
            settings,
            "default",
            self.clock,
            self._tell,
            self._start,
            self._served,
            console,
        )
        sleep = self.clock.sleep_until_ns

        def sleep_and_act(deadline_ns: int) -> None:
            sleep(deadline_ns)
            while self._script and self._script[0][0] <= self.seconds:
                self._script.pop(0)[1]()

        self.clock.sleep_until_ns = sleep_and_act  # type: ignore[method-assign]
        self.published = True

    @property
    def seconds(self) -> float:
        return (self.clock.now_ns() - NS_PER_S) / NS_PER_S

    def at(self, seconds: float, action: Callable[[], None]) -> None:
        self._script = sorted([*self._script, (seconds, action)], key=lambda entry: entry[0])

    def die(self, name: str, code: int = 1) -> Callable[[], None]:
        return lambda: setattr(self.processes[name][-1], "code", code)

    def got(self) -> list[list[str]]:
        return [process.got for processes in self.processes.values() for process in processes]

    def kinds(self) -> list[str]:
        return [f"{event.kind} {event.process}".strip() for _, event in self.events]

    def _tell(self, event: ProcessEvent) -> None:
        self.events.append((self.seconds, event))

    def _start(self, command: Sequence[str], ready: int) -> ScriptedProcess:
        name = "page" if command[0] == "hapticd" else command[0].rsplit(".", 1)[1]
        process = ScriptedProcess(100 + len(self.processes[name]), self.stubborn)
        self.processes[name].append(process)
        assert name == "page" or all(Path(argument).exists() for argument in command[1:])
        if (name == "gateway_main" and self.gateway_serves) or (
            name == "page" and self.page_serves
        ):
            os.write(ready, b"1")
        self.on_start(name, process)
        return process

    def _served(self, folder: Path, pid: int) -> bool:
        return self.published and self.processes["servo_main"][-1].pid == pid


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "run"


@pytest.fixture
def stage(folder: Path) -> Stage:
    return Stage(folder)


START = ["starting servo", "starting gateway", "ready"]
END = ["ending servo", "ending gateway", "ended"]


def test_start_and_end_in_order(stage: Stage, folder: Path) -> None:
    stage.at(1.0, stage.supervisor.stop)
    stage.supervisor.run()
    assert stage.kinds() == START + END
    assert stage.got() == [["TERM"], ["TERM"]]
    assert list(folder.iterdir()) == []


@pytest.fixture
def with_page(folder: Path) -> Stage:
    return Stage(folder, console=True)


def test_page_is_started_when_the_daemon_serves_and_ended_last(
    with_page: Stage, folder: Path
) -> None:
    with_page.on_start = lambda name, _process: write_place(folder) if name == "page" else None
    with_page.at(1.0, with_page.supervisor.stop)
    with_page.supervisor.run()
    ended = ["ending servo", "ending gateway", "ending console", "ended"]
    assert with_page.kinds() == [*START, "page console", *ended]
    assert with_page.events[3][1].text == "operators' page: http://127.0.0.1:1/"
    assert list(folder.iterdir()) == []


def write_place(folder: Path) -> None:
    """What a console notes of itself."""
    place = {"url": "http://127.0.0.1:1/", "port": 1, "pid": os.getpid()}
    (folder / files.CONSOLE).write_text(json.dumps(place))


def test_daemon_runs_without_a_page_that_cannot_be_served(with_page: Stage) -> None:
    with_page.page_serves = False
    with_page.at(1.0, with_page.die("page", 78))
    with_page.at(9.0, with_page.supervisor.stop)
    with_page.supervisor.run()
    assert with_page.kinds() == [*START, "failed console", *END]
    assert len(with_page.processes["page"]) == 1


def test_page_that_dies_comes_back_and_takes_nobody_with_it(with_page: Stage) -> None:
    for second in range(1, 10):
        with_page.at(10.0 * second, with_page.die("page", 78))
    with_page.at(99.0, with_page.supervisor.stop)
    with_page.supervisor.run()
    assert len(with_page.processes["page"]) == 10
    assert [len(with_page.processes[name]) for name in ("servo_main", "gateway_main")] == [1, 1]


def test_gateway_waits_for_the_mailbox(stage: Stage) -> None:
    stage.published = False
    stage.at(0.5, lambda: setattr(stage, "published", True))
    stage.at(1.0, stage.supervisor.stop)
    stage.supervisor.run()
    started = {
        event.process: seconds for seconds, event in stage.events if event.kind == "starting"
    }
    assert started["servo"] == 0
    assert started["gateway"] == pytest.approx(0.5, abs=0.05)


def test_missing_board_is_told_once(stage: Stage) -> None:
    stage.published = False
    stage.at(60.0, stage.supervisor.stop)
    stage.supervisor.run()
    told = [(seconds, event.text) for seconds, event in stage.events if event.kind == "waiting"]
    assert told == [
        (
            pytest.approx(5.0, abs=0.1),
            "still waiting for the servo (is the board plugged in and switched on?)",
        )
    ]


def test_silent_gateway_is_told(stage: Stage) -> None:
    stage.gateway_serves = False
    stage.at(60.0, stage.supervisor.stop)
    stage.supervisor.run()
    assert [event.text for _, event in stage.events if event.kind == "waiting"] == [
        "still waiting for the gateway"
    ]
    assert "ready" not in stage.kinds()


@pytest.mark.parametrize(
    ("name", "module", "again"),
    [
        ("servo", "servo_main", "restart 1 of 3 in 0.5 s, disabled"),
        ("gateway", "gateway_main", "restart 1 in 0.5 s, the servo stays"),
    ],
)
def test_dead_process_comes_back(stage: Stage, name: str, module: str, again: str) -> None:
    stage.at(2.0, stage.die(module, -11))
    stage.at(10.0, stage.supervisor.stop)
    stage.supervisor.run()
    assert stage.kinds() == [*START, f"restart {name}", f"starting {name}", "ready", *END]
    text = next(event.text for _, event in stage.events if event.kind == "restart")
    assert text == f"the {name} died (SIGSEGV); {again}"
    assert len(stage.processes[module]) == 2


def test_fourth_death_gives_up(stage: Stage) -> None:
    stage.on_start = lambda name, process: (
        name == "servo_main" and stage.at(stage.seconds + 0.1, stage.die(name, 3))
    )
    with pytest.raises(
        HapticdError, match=r"the servo died 4 times within 60 s \(exit code 3 at last\); giving up"
    ):
        stage.supervisor.run()
    assert len(stage.processes["servo_main"]) == 4
    assert stage.processes["gateway_main"][-1].got == ["TERM"]


@pytest.mark.parametrize("code", [-6, 78])
def test_gateway_that_is_aborted_again_and_again_never_ends_the_servo(
    stage: Stage, code: int
) -> None:
    """For ten minutes, 1 s after each start."""
    stage.on_start = lambda name, process: (
        name == "gateway_main" and stage.at(stage.seconds + 1.0, stage.die(name, code))
    )
    stage.at(600.0, stage.supervisor.stop)
    stage.supervisor.run()
    assert len(stage.processes["servo_main"]) == 1
    assert stage.processes["servo_main"][0].got == ["TERM"]
    started = [seconds for seconds, event in stage.events if event.kind == "starting"][1:]
    pauses = np.diff(started) - 1.0
    assert pauses[:5] == pytest.approx([0.5, 1, 2, 4, 8], abs=0.1)
    assert pauses.max() == pytest.approx(8.0, abs=0.1)


def test_restarts_are_counted_per_minute() -> None:
    restarts = Restarts()
    pauses = [(restarts.next_ns(t * NS_PER_S) or 0) / NS_PER_S - t for t in (0, 10, 20)]
    assert pauses == [0.5, 1.0, 2.0]
    assert restarts.next_ns(60 * NS_PER_S) is None
    assert restarts.next_ns(61 * NS_PER_S) == 63 * NS_PER_S


def test_failed_start_is_not_tried_again(stage: Stage) -> None:
    stage.published = False
    stage.at(0.1, stage.die("servo_main", 1))
    with pytest.raises(
        HapticdError, match=r"the servo could not start \(exit code 1\); see its message above"
    ):
        stage.supervisor.run()
    assert len(stage.processes["servo_main"]) == 1


def test_refused_configuration_is_not_tried_again(stage: Stage) -> None:
    stage.at(3.0, stage.die("servo_main", 78))
    with pytest.raises(ConfigError, match=r"the servo refused its configuration \(exit code 78\)"):
        stage.supervisor.run()
    assert len(stage.processes["servo_main"]) == 1


def test_stubborn_process_is_killed_after_5_s(stage: Stage) -> None:
    stage.stubborn = True
    stage.at(1.0, stage.supervisor.stop)
    stage.supervisor.run()
    assert stage.kinds() == [
        *START,
        "ending servo",
        "killed servo",
        "ending gateway",
        "killed gateway",
        "ended",
    ]
    assert stage.seconds == pytest.approx(11.0, abs=0.2)


def test_second_signal_kills_at_once(stage: Stage) -> None:
    stage.stubborn = True
    stage.at(1.0, stage.supervisor.stop)
    stage.at(1.1, stage.supervisor.stop)
    stage.supervisor.run()
    assert stage.got() == [["TERM", "KILL"]] * 2
    assert stage.seconds == pytest.approx(1.1, abs=0.2)


def test_second_supervisor_is_refused(stage: Stage, folder: Path) -> None:
    files.prepare_folder(folder)
    claim = files.claim(folder, "supervisor.lock")
    with pytest.raises(MailboxError, match=rf"a supervisor \(pid {os.getpid()}\) already runs in"):
        stage.supervisor.run()
    files.release(folder, "supervisor.lock", claim)
    assert stage.processes["servo_main"] == []
    assert not (folder / files.SERVO_JSON).exists()


def test_lock_removed_by_its_owner_is_taken_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = files.fcntl.flock

    def flock_after_release(descriptor: int, operation: int) -> None:
        monkeypatch.setattr(files.fcntl, "flock", real)
        (tmp_path / "x.lock").unlink()
        real(descriptor, operation)

    monkeypatch.setattr(files.fcntl, "flock", flock_after_release)
    claim = files.claim(tmp_path, "x.lock")
    assert (tmp_path / "x.lock").read_text() == str(os.getpid())
    files.release(tmp_path, "x.lock", claim)


def test_mailbox_counts_only_of_this_process(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir(mode=0o700)
    assert not mailbox_served(folder, os.getpid())
    mailbox = ServoMailbox(folder, 1000.0, "", True, 1)
    assert not mailbox_served(folder, os.getpid())
    mailbox.publish()
    assert mailbox_served(folder, os.getpid())
    assert not mailbox_served(folder, os.getpid() + 1)
    mailbox.publish_head(layout.TELEMETRY_HEAD_WORD, 1)
    mailbox.close()
    assert not mailbox_served(folder, os.getpid())
    assert [file.name for file in folder.iterdir()] == [files.LAST_TELEMETRY]


def test_resolved_files_hold_the_parameters(folder: Path) -> None:
    supervisor.write(folder, load(shipped("config") / "hapticd.toml"), "default")
    kinds = {
        files.SERVO_JSON: ServoParams,
        files.BOARD_JSON: BoardParams,
        files.GATEWAY_JSON: GatewaySetup,
        files.GUARD_JSON: GuardSetup,
    }
    found = {
        name: from_plain(kind, json.loads((folder / name).read_text()))
        for name, kind in kinds.items()
    }
    servo = found[files.SERVO_JSON]
    assert isinstance(servo, ServoParams)
    assert servo.config_hash == load(shipped("config") / "hapticd.toml").config_hash
    assert sorted(file.name for file in folder.iterdir()) == sorted(kinds)


def test_real_board_leaves_no_board_file(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "example-board"')
    supervisor.write(folder, load(shipped("config") / "hapticd.toml"), "default")
    assert (folder / files.BOARD_JSON).exists()
    supervisor.write(folder, load(file), "default")
    assert not (folder / files.BOARD_JSON).exists()
