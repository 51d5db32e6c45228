"""Kernels as text, as files and as machine code."""

import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest
from support.devices import COGS, COUNTS, DRY, ENDS, HAND, LIMIT, STAR, TWO_MASSES, WARMING, device
from support.engine_kernels import ALL, WALL, shape
from support.tree import ROOT, TESTS

from hapticd.model.effects import AntiAlias, Coulomb
from hapticd.zwidth.engine.source import kernel_source

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


def assembly(model, **options):
    """Assembly of the kernel, compiled anew: code from the cache has no text."""
    text = kernel_source(shape(model, **options)).replace("cache=True", "cache=False")
    names = {"__name__": "fresh_kernel"}
    exec(text, names)
    (machine_code,) = names["run"].inspect_asm().values()
    return machine_code


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


def test_kernel_is_found_again_by_another_process(tmp_path):
    """The second process loads what the first compiled: numba counts a hit and no miss."""
    code = (
        "from support.devices import *\n"
        "from hapticd.zwidth.engine import kernels\n"
        "from hapticd.zwidth.engine.batch import simulate\n"
        "from support.engine_kernels import shape, ALL\n"
        "simulate(ALL, [[1, 0, 0]], 0.01)\n"
        "run = kernels.kernel(shape(ALL)).run\n"
        "print(sum(run.stats.cache_hits.values()), sum(run.stats.cache_misses.values()))"
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
