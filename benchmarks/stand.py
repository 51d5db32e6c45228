"""The bench: the shipped simulated device at some rate, with K = 100 N/m, B = 1 N s/m, M = 10 g."""

import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hapticd.run.supervisor import resolve
from hapticd.settings.load import Override, Settings, load
from hapticd.settings.toml import shipped

ENVIRONMENT = {"stiffness_n_per_m": 100.0, "virtual_damping_ns_per_m": 1.0, "mass_kg": 0.01}
HOST_S = 125e-6


def settings(rate_hz: float = 1000.0, core: int | None = None, **gateway: Any) -> Settings:
    """Return the shipped configuration, independent of the user's own; on `core`, if given."""
    tables = {
        "realtime": {"rate_hz": rate_hz} | ({} if core is None else {"core": core}),
        "environment": ENVIRONMENT,
        "simulation": {"sample_phase": sample_phase(rate_hz)},
        "gateway": gateway,
    }
    asked = tuple(
        Override((table, name), value, "benchmark")
        for table, rows in tables.items()
        for name, value in rows.items()
    )
    return load(shipped("config") / "hapticd.toml", asked)


def sample_phase(rate_hz: float) -> float:
    """Return the latch time of the encoder, in periods after OUT: it leaves the host the 125 us of
    1 kHz, or half a period.
    """
    return max(0.5, 1.0 - HOST_S * rate_hz)


@contextmanager
def parameter_file(rate_hz: float = 1000.0, core: int | None = None) -> Iterator[str]:
    """Yield a file for `bench_servo.read_parameters`: a worker loads neither TOML nor pydantic,
    like the servo process.
    """
    with tempfile.TemporaryDirectory(prefix="hapticd-bench-") as folder:
        path = Path(folder) / "stand.json"
        path.write_text(json.dumps(resolve(settings(rate_hz, core), "bench")))
        yield str(path)
