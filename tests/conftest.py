"""Fixtures that several files use, and which tests may be skipped where every test has to run."""

import gc
import os
import shutil
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from hapticd.mailbox import files
from hapticd.usb.link import UsbLink

if TYPE_CHECKING:
    from support.recorded import RecordedFlight

# as an installation has it by its entry point, also where hapticd is only on the path
pytest_plugins = ["hapticd.pytest_plugin"]

# helpers; the cases of usb_guest run in another kernel, with their own conftest.py
collect_ignore = ["support"]

MAY_BE_SKIPPED = {"test_lane_loop_is_vector_code"}  # it reads the assembly of x86


@pytest.fixture(params=["in_flight", "in_turn"])
def either_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs twice: with transfers in flight, and one after the other."""
    made = UsbLink._transfers

    def transfers(link: UsbLink, *interface: Any) -> Any:
        link._params = replace(link._params, in_flight=request.param == "in_flight")
        return made(link, *interface)

    monkeypatch.setattr(UsbLink, "_transfers", transfers)


def pytest_addoption(parser: pytest.Parser) -> None:
    text = "a test that is skipped fails the run, except " + ", ".join(sorted(MAY_BE_SKIPPED))
    parser.addoption("--all-must-run", action="store_true", help=text)
    text = "write the answers to mistakes at the shell into support/data/cli_mistakes.txt"
    parser.addoption("--write-texts", action="store_true", help=text)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """On workers run slow tests and their files first, so that none runs alone at the end."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Freeze tests and modules, which live to the end, and collect garbage less often after that.

    By default the oldest generation is collected whenever it has grown by a quarter, and frozen
    objects do not count. That took a tenth of the time of unit tests.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(10_000, 20, 20)
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    missed = _missed(session.config)
    if missed and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    missed = _missed(config)
    if missed:
        terminalreporter.section("not run, and every test has to (--all-must-run)", red=True)
        terminalreporter.write_line("\n".join(missed))


def _missed(config: pytest.Config) -> list[str]:
    """Return the ids of tests, or of whole files, that were skipped without permission."""
    if not config.getoption("--all-must-run"):
        return []
    reporter = config.pluginmanager.getplugin("terminalreporter")
    return [
        report.nodeid
        for report in reporter.stats.get("skipped", [])
        if not _may_be_skipped(report.nodeid)
    ]


def _may_be_skipped(nodeid: str) -> bool:
    return nodeid.rpartition("::")[2].partition("[")[0] in MAY_BE_SKIPPED


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Yield an empty runtime folder for one test, with the shipped configuration only."""
    yield from fresh_runtime(monkeypatch)


def fresh_runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of `runtime`, for a fixture of any scope.

    Directly in the temporary folder, since a socket's path may have 107 bytes only.
    """
    folder = Path(tempfile.mkdtemp(prefix="hapticd-test-"))
    for name in ("RUNTIME_DIRECTORY", "HAPTICD_CONFIG", "HAPTICD_INSTANCE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder / "config"))
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    # whatever runs on this machine
    monkeypatch.setattr(files, "SERVICE_FOLDER", folder / "no-service")
    monkeypatch.setattr(files, "SESSION_FOLDERS", folder / "no-sessions")
    monkeypatch.setattr(files, "MEMORY_FOLDER", folder / "no-memory")
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="session")
def recorded_run() -> "RecordedFlight":
    """Three seconds with active damping switched live, two lost frames, and a code at the event
    pins of the board; the stack is gone, its messages are there.
    """
    from support.boards import board_params
    from support.recorded import RecordedFlight

    from hapticd.mailbox.layout import Command, Value
    from hapticd.model.params import InjectionParams

    injections = (
        InjectionParams("drop_in", tick=1500, count=2),
        InjectionParams("event_code", tick=1499, value=17),
        InjectionParams("event_code", tick=1600, value=0),
        InjectionParams("event_code", tick=2100, value=18),
    )
    board = board_params(injections=injections)
    with RecordedFlight(board=board) as run:
        run.move()
        run.fly(1000)
        run.stack.do(Command.DAMPING, {Value.ACTIVE_DAMPING: 1.74, Value.ACTIVE_DAMPING_ON: 1.0})
        run.fly(1000)
        run.stack.do(Command.STOP)
        run.fly(1000)
        run.recorded = run.records  # type: ignore[attr-defined]
    return run


@pytest.fixture(scope="session")
def recording_file(
    recorded_run: "RecordedFlight", tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A finished recording of `recorded_run`."""
    from support.recorded import recorded_into

    path = tmp_path_factory.mktemp("recording") / "run.h5"
    assert recorded_into(path, recorded_run)["ended"] == "daemon ended"
    return path
