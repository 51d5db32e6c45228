"""Kernels as text, as files and as machine code."""

import platform
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit
from support.devices import COGS, COUNTS, DRY, ENDS, HAND, LIMIT, STAR, TWO_MASSES, WARMING, device
from support.tree import ROOT, TESTS

from hapticd.analysis.arrays import aligned
from hapticd.engine import kernels, simulate
from hapticd.engine.kernels import cache_folder, kernel
from hapticd.engine.shape import reduced, shape_of
from hapticd.engine.source import SCALARS, kernel_source
from hapticd.errors import ConfigError
from hapticd.params import EnvironmentParams, WallParams
from hapticd.plant.effects import AntiAlias, Coulomb, ForceDac

ALL = device(*TWO_MASSES, DRY, COUNTS, LIMIT)
LARGE = device(
    *STAR,
    Coulomb(rotor_n=0.02, slider_n=0.01),
    COUNTS,
    LIMIT,
    AntiAlias(corner_hz=1000.0),
    HAND,
    delay=1.5,
)
HOT = device(*STAR, DRY, COUNTS, LIMIT, WARMING)
X86 = pytest.mark.skipif(
    platform.machine() != "x86_64", reason="looks for the vector registers of x86"
)
WALL = EnvironmentParams(wall=WallParams(stiffness_n_per_m=1000.0, position_m=0.001, side=1))


def shape(model, damped=False, substeps=1, dtype="f64", environment=None):
    return shape_of(
        reduced(model, damped)[0], environment or EnvironmentParams(), damped, substeps, dtype
    )


def assembly(model, **options):
    """Assembly of the kernel, compiled anew: code from the cache has no text."""
    made = shape(model, **options)
    module = kernel(made)
    scalar = SCALARS[made.dtype]
    fresh = njit(fastmath={"contract", "nsz"}, error_model="numpy")(module.run.py_func)
    coefficients, torque, nothing = (
        np.zeros(size, scalar) for size in (len(module.COEFFICIENTS) or 1, made.samples, 1)
    )
    fresh(
        aligned(len(module.ROWS) * made.lanes, scalar), coefficients, torque, nothing, nothing, 1, 0
    )
    (text,) = fresh.inspect_asm().values()
    return text


@X86
@pytest.mark.parametrize("dtype", ["f32", "f64"])
@pytest.mark.parametrize(
    ("model", "environment", "damped"),
    [
        (ALL, None, False),
        (ALL, WALL, False),
        (device(*TWO_MASSES, COGS, ENDS), None, False),
        (LARGE, None, True),
        (HOT, None, True),
    ],
    ids=["all", "wall", "places", "large", "hot"],
)
def test_lane_loop_is_vector_code(model, environment, damped, dtype):
    """Every multiplication and addition of the tick works on whole registers, from a stack that
    begins on a cache line.
    """
    text = assembly(model, environment=environment, dtype=dtype, damped=damped)
    loop = max(re.split(r"\n(?=\.LBB)", text), key=lambda block: len(re.findall(r"[yz]mm", block)))
    kind = "ps" if dtype == "f32" else "pd"
    vector = re.findall(rf"\bv?(?:fn?m(?:add|sub)\d+|mul|add|sub){kind}\b", loop)
    scalar = re.findall(rf"\bv?(?:fn?m(?:add|sub)\d+|mul|add|sub)s{kind[1]}\b", loop)
    assert len(vector) > 100
    assert not scalar
    assert re.search(r"[yz]mm", loop)
    assert re.search(r"andq\s+\$-64, %rsp", text) or "zmm" not in text


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (
            (),
            (
                "floor",
                "LEVEL",
                "WALL",
                "STOP",
                "PULL0_0",
                "WAIT",
                "FORCE_COUNT",
                "HEAT",
                "TRAVEL",
                " LIMIT",
            ),
        ),
        ((COUNTS,), ("LEVEL", "WALL", "STOP", "PULL0_0", "FORCE_COUNT")),
        ((DRY,), ("floor", "WALL", "STOP", "PULL0_0")),
    ],
)
def test_absent_effect_leaves_no_trace(extra, words):
    text = kernel_source(shape(device(*TWO_MASSES, *extra)))
    assert not [word for word in words if word in text]


def test_effects_leave_theirs():
    text = kernel_source(
        shape(
            device(
                *TWO_MASSES, DRY, COUNTS, LIMIT, COGS, ENDS, ForceDac(quantum_n=0.001), delay=1.5
            ),
            environment=WALL,
        )
    )
    assert all(
        word in text
        for word in (
            "floor",
            "LEVEL0",
            "WALL_K",
            "STOP_UP",
            "PULL0_0",
            "WAIT0",
            "FORCE_COUNT",
            "LIMIT",
        )
    )


def test_relative_positions_and_unused_states_save_coefficients():
    relative, whole = (shape(device(*STAR), damped=damped) for damped in (False, True))
    assert (relative.states, whole.states) == (6, 7)
    assert (
        sum(map(len, whole.feeds)) == 37
    )  # of 49: the rotor's position drives nothing, the smoothed command is its own
    assert sum(map(len, relative.feeds)) < 37


def test_numbers_do_not_make_a_new_kernel():
    softer = device(*replace_coupling(1.7e4), DRY, COUNTS, LIMIT)
    assert shape(softer) == shape(ALL)
    assert kernel(shape(softer)) is kernel(shape(ALL))


def replace_coupling(stiffness):
    return [
        replace(e, stiffness_n_per_m=stiffness) if e.key == "coupling" else e for e in TWO_MASSES
    ]


def test_kernel_is_found_again_by_another_process(tmp_path):
    """The second process loads what the first compiled: numba counts a hit and no miss."""
    code = (
        "from support.devices import *; from hapticd.engine import kernels, simulate; from"
        " test_engine_kernels import shape, ALL\nsimulate(ALL, [[1, 0, 0]], 0.01); run ="
        " kernels.kernel(shape(ALL)).run\nprint(sum(run.stats.cache_hits.values()),"
        " sum(run.stats.cache_misses.values()))"
    )
    path = f"{Path(__file__).parent}:{TESTS}:{ROOT}"
    found = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=TESTS,
            env={"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": path},
        ).stdout.split()
        for _ in range(2)
    ]  # fmt: skip
    assert found == [["0", "1"], ["1", "0"]]
    assert len(list(tmp_path.glob("hapticd/kernels-*/k_*.py"))) == 1


def test_cache_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder().parent == tmp_path / "hapticd"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder().parent.parent.name == ".cache"


def test_unwritable_cache_folder_is_named(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match="set XDG_CACHE_HOME"):
        kernel(replace(shape(ALL), lanes=48))


def test_without_numba_the_remedy_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(ConfigError, match=r"install hapticd\[fast\]"):
        kernels.kernel.__wrapped__(shape(ALL))


def test_engine_is_imported_without_numba():
    code = "import sys, hapticd.engine; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_lanes_of_a_group_are_independent():
    """70 trials and 1 trial of the same parameters: the same numbers in any lane."""
    many = simulate(ALL, [[100.0, 0.3, 0.001]] * 70, 0.1)
    assert len(set(many.sigma_v_m_per_s)) == 1
