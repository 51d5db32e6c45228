"""`rig verify`: known parts as the probe sees them, and the certificate."""

import dataclasses
import datetime
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from support.rig_hand import Hand
from support.rig_verify import EMF, FREE, SHORT, nothing, verified

from hapticd.cli.rig import steps
from hapticd.core.environment import FilterParams
from hapticd.core.errors import AnalysisError
from hapticd.core.params import to_plain
from hapticd.rig.result import Value
from hapticd.rig.steps import verify
from hapticd.rig.steps import verify as vectors
from hapticd.rig.steps.verify import (
    KnownParts,
    Rendering,
    agreement,
    difference,
    expected,
    measure,
    parts_of,
    seen,
)
from hapticd.settings.load import load
from hapticd.settings.toml import shipped
from hapticd.signal.impedance import Impedance

WAY = Rendering(1000.0, 125.0, 0.0, (FilterParams(100.0), FilterParams(72.0)))
F_HZ = np.linspace(8.0, 150.0, 50)


# --- what the probe sees --------------------------------------------------------------------------


def z_of(values):
    ones = np.ones_like(F_HZ)
    return Impedance(F_HZ, values, 0.01 * ones, ones, ones, ones, "h_force", "probe", 40.0)


ALL = parts_of(KnownParts(60.0, 1.0, 0.004, 0.01, 500.0))


@pytest.mark.parametrize(("smoothing_ms", "encoder"), [(0.0, 0.0), (0.5, 2.0)])
def test_each_part_is_found_beside_friction_smoothing_and_a_resonance(smoothing_ms, encoder):
    free = 2j * np.pi * F_HZ * 0.008 + 0.7
    path = 1.0 / (1.0 + 2e-3j * np.pi * F_HZ * smoothing_ms)
    more = 1.0 / (1.0 - 1e-5 * encoder * F_HZ**2)
    changes = []
    for part in ALL:
        theory = expected(part, F_HZ, WAY) * (more**2 if part.request else path * more)
        changes.append(difference(part, z_of(free), z_of(free + 1.03 * theory + 0.05), WAY))
    for part, found in zip(ALL, seen(changes), strict=True):
        assert found.value == pytest.approx(1.03 * part.size, rel=1e-6), part.name
        assert found.low < found.value < found.high


def test_what_is_rendered_comes_late_and_through_its_smoothing():
    """At low frequencies a spring is K/jw; K (T/2 + d T + 1/w_r) is what it takes of damping."""
    (spring, *_) = parts_of(KnownParts())
    low = np.array([0.01])
    slow = dataclasses.replace(WAY, smoothing_hz=32.0)
    (found,) = expected(spring, low, slow)
    assert found.imag == pytest.approx(-60.0 / (2 * np.pi * 0.01), rel=1e-5)
    late_s = 0.5e-3 + 0.125e-3 + 1.0 / (2 * np.pi * 32.0)
    assert found.real == pytest.approx(-60.0 * late_s, rel=1e-3)


def test_attached_parts_rest_on_the_probe_alone():
    parts = {one.name: one for one in parts_of(KnownParts(attached_kg=0.01))}
    device = {
        "force": {"half_width_95": None},
        "position": {"half_width_95": None},
        "probe_torque": {"per_count": 2.0, "half_width_95": 0.02},
        "probe_velocity": {"per_count": 2.0, "half_width_95": 0.02},
    }
    off = Value("attached mass", 0.01015, "kg", 0.01014, 0.01016)
    assert agreement(parts["attached mass"], off, device).verdict == "refused"
    near = dataclasses.replace(off, value=0.0101)
    found = agreement(parts["attached mass"], near, device)
    assert found.verdict == "ok"
    assert "no interval known" not in found.what
    spring = Value("rendered spring", 60.6, "N/m", 60.5, 60.7)
    assert "force, position" in agreement(parts["rendered spring"], spring, device).what


def test_a_device_whose_signs_nobody_saw_is_not_shaken():
    with (
        Hand({"commissioning": True}) as hand,
        pytest.raises(AnalysisError, match="verified once the signs are verified"),
    ):
        measure(hand.bench, nothing, SHORT)


def test_ctrl_c_ends_the_force():
    def interrupted(request):
        raise KeyboardInterrupt

    asked = KnownParts(seconds=5.0, attached_kg=0.01)
    with Hand(**FREE) as hand:
        with pytest.raises(KeyboardInterrupt):
            measure(hand.bench, interrupted, asked)
        assert hand.bench.status().state == "disabled"


def test_old_calibrations_are_findings_with_their_step():
    with Hand(**FREE) as hand:
        servo = to_plain(hand.bench.hello().servo) | {"simulated": False}
        found = list(verify._calibrations(servo, datetime.date(2026, 1, 1)))
    assert {one.verdict for one in found} == {"refused"}
    assert found[0].remedy == "`hapticd rig encoder`"


# --- vectors --------------------------------------------------------------------------------------


def test_this_installation_computes_what_it_should():
    assert [one.verdict for one in vectors.compared()] == ["ok", "ok", "ok"]


@pytest.mark.parametrize(
    ("name", "wrong", "place"),
    [
        ("required_damping", lambda right: lambda *a: (1.001 * right(*a)[0], None), 0),
        ("spa", lambda right: lambda f, v, *a, **k: right(f, 1.000001 * v, *a, **k), 1),
    ],
)
def test_an_installation_that_computes_otherwise_is_refused(monkeypatch, name, wrong, place):
    monkeypatch.setattr(vectors, name, wrong(getattr(vectors, name)))
    found = vectors.compared()
    assert [number for number, one in enumerate(found) if one.verdict == "refused"] == [place]


def test_a_codec_that_reads_otherwise_is_refused_by_the_frame(monkeypatch):
    right = vectors.DECODE["in"]

    def turned(data):
        frame = right(data)
        return frame._replace(encoder=frame.encoder + 1)

    monkeypatch.setitem(vectors.DECODE, "in", turned)
    found = vectors.compared()[2]
    assert found.verdict == "refused"
    assert "every_byte_differs" in found.what


# --- the certificate ------------------------------------------------------------------------------


@pytest.fixture
def config(tmp_path: Path) -> Path:
    (tmp_path / "devices").mkdir()
    text = (shipped("config") / "devices" / "simulated.toml").read_text()
    (tmp_path / "devices" / "own.toml").write_text(text)
    file = tmp_path / "hapticd.toml"
    file.write_text('device = "own"\n')
    return file


@pytest.fixture
def hand(config, monkeypatch):
    """A rig whose daemon was started with the device file of `config`."""
    settings = load(config)
    with Hand({"emf_velocity": EMF}, **FREE) as found:
        bench = found.bench
        bench._servo = dataclasses.replace(
            bench._servo,
            device_file=str(settings.device_file),
            device_file_sha256=settings.device_file_sha256,
        )

        @contextmanager
        def connected(instance):
            yield bench

        monkeypatch.setattr(steps, "connect", connected)
        monkeypatch.setattr(steps, "PAUSE_S", 0.0)
        yield found


def test_a_device_file_that_the_daemon_has_not_read_is_not_certified(config, hand, capsys):
    file = load(config).device_file
    file.write_text(file.read_text() + "\n# edited\n")
    assert verified(config) == 78
    assert "start it again" in capsys.readouterr().err
    assert not (file.parent / "rig").exists()
