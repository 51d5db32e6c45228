"""The batch engine's kernel compared with hand-written C, numba without lanes, MuJoCo and scipy,
and the cost of its effects.

Nanoseconds of CPU per plant step of one trial; all compared runs are interleaved in this process,
minimum of all rounds.
"""

from collections.abc import Callable, Iterator
from typing import Any

from benchmarks import targets
from benchmarks.engine_c import C_LANES, CReference, check_same
from benchmarks.engine_peers import ScalarNumba, mujoco_run, solve_ivp_run
from benchmarks.engine_scene import Lanes, least_cpu_s, model
from benchmarks.figures import Figure, compared
from benchmarks.worker import BenchError

TARGETS = targets.of("engine")
TICKS = 1024
ROUNDS = 40
MUJOCO_TICKS = 1000
MUJOCO_ROUNDS = 5
SOLVER_TICKS = 100
SOLVER_ROUNDS = 3
ALIKE = 0.1  # of the rms velocity of a short run; integrators, friction models and delay differ
LINEAR = ("coulomb", "encoder", "saturation", "delay")
NS = 1e9


def measure() -> Iterator[Figure]:
    """Yield all figures, or the reason why one is missing."""
    for dtype in ("f32", "f64"):
        yield _beside_c(f"engine_c_{dtype}", dtype)
    yield _beside_scalar()
    yield from _beside_peers()
    yield from _effects()


def _beside_c(name: str, dtype: str) -> Figure:
    ours = Lanes(model(), dtype, TICKS)
    runs: dict[str, Any] = {"ours": ours}
    for lanes in C_LANES[dtype]:
        runs[f"C {lanes}"] = CReference(Lanes(model(), dtype, TICKS), dtype, lanes)
        check_same(Lanes(model(), dtype, TICKS), runs[f"C {lanes}"], dtype)
    times = least_cpu_s(runs, ROUNDS)
    best = min(times[f"C {lanes}"] / lanes for lanes in C_LANES[dtype]) * ours.lanes
    return _compared(
        name,
        times["ours"],
        ours.steps,
        best,
        "reference: cc -O3 -march=native, best of three lane counts",
    )


def _beside_scalar() -> Figure:
    ours = Lanes(model(), "f32", TICKS)
    times = least_cpu_s({"ours": ours, "scalar": ScalarNumba(ours)}, ROUNDS // 2)
    return _compared(
        "engine_numba_scalar", times["scalar"] * ours.lanes, ours.steps, times["ours"], "f32"
    )


def _beside_peers() -> Iterator[Figure]:
    ours = Lanes(model(), "f64", MUJOCO_TICKS)
    ours_s = least_cpu_s({"ours": ours}, ROUNDS)["ours"] / ours.steps
    torque = ours.torque.astype(float)
    expected = _rms(torque)
    peers: tuple[tuple[str, Callable[..., Callable[[], float]], int, int], ...] = (
        ("engine_mujoco", mujoco_run, MUJOCO_TICKS, MUJOCO_ROUNDS),
        ("engine_solve_ivp", solve_ivp_run, SOLVER_TICKS, SOLVER_ROUNDS),
    )
    for name, make, ticks, rounds in peers:
        run = make(torque, ticks)
        found = run()
        if not abs(found / expected[ticks] - 1.0) < ALIKE:
            raise BenchError(
                f"{name}: rms velocity {found:.3g} m/s, the engine's is {expected[ticks]:.3g} m/s;"
                " not the same scene"
            )
        theirs_s = least_cpu_s({name: run}, rounds)[name]
        yield _compared(
            name,
            theirs_s,
            4 * ticks,
            ours_s * 4 * ticks,
            "f64, one trial against its share of a group",
        )


def _rms(torque: Any) -> dict[int, float]:
    """Return the engine's rms velocity of trial 0 over the lengths of the peers."""
    lengths = {}
    for ticks in (SOLVER_TICKS, MUJOCO_TICKS):
        lanes = Lanes(model(), "f64", ticks)
        lanes.torque = torque[: 4 * ticks].copy()
        lanes()
        squares = lanes.group.tallied()["SPEED2"][0]
        lengths[ticks] = float((squares / (4 * ticks)) ** 0.5)
    return lengths


def _effects() -> Iterator[Figure]:
    runs: dict[str, Any] = {
        "all": Lanes(model(), "f32", TICKS),
        "friction_off": Lanes(model("coulomb"), "f32", TICKS),
        "plant_only": Lanes(model(*LINEAR), "f32", TICKS, renders=False),
    }
    times = least_cpu_s(runs, ROUNDS)
    steps = runs["all"].steps
    yield _compared(
        "effects_friction_off",
        times["all"],
        steps,
        times["friction_off"],
        "f32, the same scene without friction",
    )
    yield _compared(
        "effects_plant_only",
        times["friction_off"],
        steps,
        times["plant_only"],
        "f32, without law, counts, limit as well",
    )


def _compared(name: str, seconds: float, steps: int, reference_s: float, note: str) -> Figure:
    return compared(name, TARGETS[name], NS * seconds / steps, "ns", NS * reference_s / steps, note)
