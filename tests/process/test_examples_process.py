"""Examples that need a daemon, as their readers run them: each in a process of its own, by the
fixtures that people's own tests have.
"""

import shutil
import sys

import pytest
from support.beside_daemon import run_beside
from support.tree import ROOT

EXAMPLES = ROOT / "examples"

pytestmark = pytest.mark.process


@pytest.fixture
def hapticd_config(tmp_path):
    """A host that may be busy: the real-time rights of the machine are not asked for, and springs
    that late ticks make active end no session.
    """
    path = tmp_path / "hapticd.toml"
    path.write_text(
        '[realtime]\nmode = "off"\n[safety]\nlimit_cycle_faults = false\n'
        "[gateway]\ntelemetry_port = 0\n"
    )
    return path


def python(daemon, folder, name, *words):
    return run_beside(daemon, folder, sys.executable, EXAMPLES / f"{name}.py", *words).splitlines()


def state(daemon):
    with daemon.client() as device:
        found = device.status()
    faults = [one.fault for one in found.events if one.fault != "none"]
    return found.state if found.state != "fault" else f"fault: {faults[-1]}"


def test_sweep_example(hapticd_daemon, tmp_path):
    lines = python(hapticd_daemon, tmp_path, "sweep")
    assert [line.split()[2] for line in lines] == ["50", "100", "200", "400"]
    assert state(hapticd_daemon) == "disabled"


def test_toggle_example_moves_less_with_damping(hapticd_daemon, tmp_path):
    lines = python(hapticd_daemon, tmp_path, "toggle")
    speeds = [float(line.split(":")[1].split()[0]) for line in lines]
    assert max(speeds[0], speeds[2]) < min(speeds[1], speeds[3])


def test_steps_example_acts_step_by_step(hapticd_daemon, tmp_path):
    lines = python(hapticd_daemon, tmp_path, "steps", "--pause", "1.0")
    ticks = [int(line.split()[1].rstrip(",")) for line in lines]
    assert len(lines) == 7
    assert ticks == sorted(set(ticks))
    assert state(hapticd_daemon) == "disabled"


def test_wall_example_finds_a_stiffer_wall_with_damping(hapticd_daemon, tmp_path):
    without, damped = (float(line.split()[-2]) for line in python(hapticd_daemon, tmp_path, "wall"))
    assert 0.0 < 2.0 * without < damped
    assert state(hapticd_daemon) == "disabled"


def test_jnd_example_finds_what_the_simulated_observer_notices(hapticd_daemon, tmp_path):
    (line,) = python(hapticd_daemon, tmp_path, "jnd", "--simulated", "--pause", "0.01")
    assert 4.0 < float(line.split()[2]) < 36.0  # of 12 %, by eight reversals
    assert len((tmp_path / "jnd.csv").read_text().splitlines()) > 20


def test_cpp_example_acquires_in_another_process(hapticd_daemon, tmp_path):
    compiler = shutil.which("c++") or pytest.skip("no C++ compiler")
    source = EXAMPLES / "cpp" / "acquire.cpp"
    flags = ("-std=c++17", "-Wall", "-Wextra", "-Werror", "-DMSGPACK_NO_BOOST")
    run_beside(
        hapticd_daemon, tmp_path, compiler, *flags, "-o", tmp_path / "acquire", source, "-lzmq"
    )
    with hapticd_daemon.client() as device:
        endpoints = device.status().endpoints
    words = (endpoints["command"], endpoints["telemetry"][0])
    assert run_beside(hapticd_daemon, tmp_path, tmp_path / "acquire", *words).startswith(
        "1000 ticks"
    )
    assert state(hapticd_daemon) == "disabled"


def test_octave_example_sets_and_enables(hapticd_daemon, tmp_path):
    octave = shutil.which("octave-cli") or pytest.skip("no Octave")
    with hapticd_daemon.client() as device:
        endpoint = device.status().endpoints["command"]
    text = run_beside(hapticd_daemon, tmp_path, octave, EXAMPLES / "octave" / "client.m", endpoint)
    assert "K = 100 N/m" in text
    assert "state: enabled" in text
    assert state(hapticd_daemon) == "disabled"
