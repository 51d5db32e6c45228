"""What is delivered of the active damping, on the lock-step stack, against the closed form of the
damping circuit (Weir, Colgate and Peshkin 2008, section 5).
"""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from support.delivered import (
    DISPLAY,
    LEVEL,
    N_PER_A,
    circuit,
    flown,
    followed,
    holds,
    parts,
)

from hapticd.core.arrays import Records
from hapticd.core.params import ServoParams
from hapticd.model.params import InjectionParams


def test_without_damping_nothing_is_delivered():
    found, lows = followed(*flown(DISPLAY, 0.0))
    assert holds(found, 0.0)
    assert found.high < 0.1
    assert found.ratio is None
    assert not lows


def test_at_rest_it_is_unknown():
    found, lows = followed(*flown(DISPLAY, LEVEL, 0.0))
    assert found.estimate_ns_per_m is None
    assert found.basis == "unknown: the handle hardly moves"
    assert not lows


@cache
def failed(kinds: tuple[tuple[str, float], ...]) -> tuple[ServoParams, Records]:
    """A device whose damping circuit or amplifier fails at 3 s."""
    injections = tuple(
        InjectionParams(kind, tick=3000, count=100_000, value=value) for kind, value in kinds
    )
    return flown(ticks=11_000, shaken_ticks=11_000, injections=injections)


def changed(records: Records, **columns: Any) -> Records:
    """A copy with these columns."""
    found = records.copy()
    for name, values in columns.items():
        found[name] = values
    return found


def test_without_back_emf_the_encoder_serves_and_it_is_said():
    servo, records = flown()
    found, _ = followed(servo, changed(records, emf_velocity_m_per_s=0.0))
    assert holds(found, circuit(LEVEL))
    assert found.basis == "current and encoder, no back-EMF"


def test_device_file_without_force_per_ampere_leaves_it_unknown():
    servo, records = flown()
    unknown = replace(servo, device=replace(servo.device, motor_n_per_a=0.0))
    found, _ = followed(unknown, records)
    assert found.estimate_ns_per_m is None
    assert found.commanded == pytest.approx(LEVEL, abs=1e-3)


@pytest.mark.parametrize("name", ["current_a", "voltage_v", "emf_velocity_m_per_s"])
@pytest.mark.parametrize("value", [np.nan, np.inf, "full"])
def test_what_is_not_measured_is_left_out(name, value):
    """Every seventh sample of the second half is NaN, infinite or at the converter's end."""
    servo, records = flown()
    scale = getattr(servo.device, name.rpartition("_m_per_s")[0] or name[:-2])
    wrong = 32767 * scale.per_count if value == "full" else value
    values = records[name].copy()
    values[1500::31] = wrong
    found, lows = followed(servo, changed(records, **{name: values}))
    assert holds(found, circuit(LEVEL))
    assert not lows


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("seed", range(10))
def test_no_record_ends_the_gateway(seed):
    """Numbers of any size, NaN and infinite ones, in every field that is read."""
    servo, records = flown()
    random = np.random.default_rng(seed)
    wild = records.copy()
    names = ("position_m", "force_n", "current_a", "voltage_v", "emf_velocity_m_per_s")
    for name in (*names, "winding_c", "board_us", "active_damping_ns_per_m"):
        places = random.random(len(wild)) < random.choice([0.0, 0.003, 0.3])
        odd = random.choice([0.0, 1.0, -1e30, 1e-30, np.nan, np.inf], len(wild))
        values = wild[name].astype(float)
        values[places] = odd[places]
        wild[name] = np.nan_to_num(values) if name == "board_us" else values
    found, lows = followed(servo, wild)
    assert found.low is None or np.isfinite([found.low, found.high]).all()
    assert not lows


def test_current_that_saturates_is_no_current():
    servo, records = flown()
    most = 0.02
    narrow = replace(servo.device.current, per_count=most / 32767)
    limited = np.clip(records["current_a"], -most, most)
    saturated = replace(servo, device=replace(servo.device, current=narrow))
    found, lows = followed(saturated, changed(records, current_a=limited))
    assert found.low is None or holds(found, circuit(LEVEL))
    assert not lows


def test_estimate_does_not_depend_on_how_records_come():
    servo, records = flown()
    assert followed(servo, records, 1)[0] == followed(servo, records, 997)[0]


@pytest.mark.parametrize("off", [slice(None), slice(0, 80)])
def test_only_torque_that_is_granted_counts(off):
    """Without authority a board may switch its amplifier off and damp nothing: all the time, or 80
    of 250 ms.
    """
    servo, records = flown()
    withheld = records.copy()
    for start in range(0, len(records), 250):
        part = withheld[start : start + 250][off]
        part["status"] = 0
        part["current_a"] = 0.0
    found, lows = followed(servo, withheld)
    assert not lows
    if off.stop:
        assert holds(found, circuit(LEVEL))
    else:
        assert found.estimate_ns_per_m is None


def test_device_files_say_the_force_per_ampere():
    """Of a real board what homing goes by, else what is simulated."""
    servo, _ = parts()
    assert servo.device.motor_n_per_a == pytest.approx(N_PER_A)
    assert (servo.device.winding_ohm, servo.device.winding_reference_c) == (1.6, 20.0)
