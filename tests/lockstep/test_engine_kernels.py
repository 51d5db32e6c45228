"""Kernels as text, as files and as machine code."""

import subprocess
import sys
from dataclasses import replace

import pytest
from support.devices import COGS, COUNTS, DRY, ENDS, LIMIT, STAR, TWO_MASSES, device
from support.engine_kernels import ALL, WALL, shape

from hapticd.core.errors import ConfigError, MissingLibrary
from hapticd.model.effects import ForceDac
from hapticd.zwidth.engine import kernels
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.kernels import cache_folder, kernel
from hapticd.zwidth.engine.source import kernel_source


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
    with pytest.raises(MissingLibrary) as missing:
        kernels.kernel.__wrapped__(shape(ALL))
    assert missing.value.requirement.startswith("numba>=")


def test_engine_is_imported_without_numba():
    code = "import sys, hapticd.zwidth.engine; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_lanes_of_a_group_are_independent():
    """70 trials and 1 trial of the same parameters: the same numbers in any lane."""
    many = simulate(ALL, [[100.0, 0.3, 0.001]] * 70, 0.1)
    assert len(set(many.sigma_v_m_per_s)) == 1
