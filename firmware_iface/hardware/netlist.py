"""The netlists as decks for ngspice: values, one run in batch mode, results from its raw file.

`VALUES` is read from values.inc, which has each value with unit, tolerance and source. A run can
override values by name. ngspice runs as a child process and is not part of this program.
"""

import re
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

__all__ = ["FOLDER", "VALUES", "NgspiceError", "Value", "deck", "draw", "run"]

FOLDER = Path(__file__).parent
LINE = re.compile(r"\.param\s+(\w+)\s*=\s*(\S+)\s*\$\s*([^;]+);\s*([^;]+);\s*(.+)")
SOURCES = (
    "sheet",
    "sheet, from memory",
    "sheet, from a distributor",
    "paper",
    "device",
    "design",
    "assumed",
)
OPTIONS = ".options reltol=1e-5 abstol=1e-10 vntol=1e-8 method=gear maxord=2 rshunt=1e12"
INPUTS = {"dac": "{v_ref/2}", "ref": "{v_ref}", "level": "{d_level}", "trim": "{trim}"}
# messages of ngspice: an analysis that ended early; an operating point from a transient of 10 us,
# which has not settled
FAILED = ("aborted", "Transient op started")
RUN_S = 120.0  # longer than any run of these decks takes on a slow machine

Waves = dict[str, np.ndarray]


class NgspiceError(RuntimeError):
    """ngspice could not run a deck; its own message."""


@dataclass(frozen=True)
class Value:
    """One value of the circuit."""

    name: str
    value: float
    unit: str
    tolerance: float  # relative; absolute where the value is 0
    source: str

    @property
    def half_width(self) -> float:
        """Half of the tolerance interval, in the value's unit."""
        return self.tolerance * abs(self.value) if self.value else self.tolerance


def _read(path: Path) -> dict[str, Value]:
    found = {}
    for line in path.read_text().splitlines():
        if match := LINE.match(line):
            name, value, unit, tolerance, source = match.groups()
            found[name] = Value(name, float(value), unit.strip(), float(tolerance), source)
    return found


VALUES = _read(FOLDER / "values.inc")


def draw(rng: np.random.Generator) -> dict[str, float]:
    """Return one circuit of parts within their tolerances, drawn from uniform distributions."""
    return {
        one.name: one.value + one.half_width * float(rng.uniform(-1.0, 1.0))
        for one in VALUES.values()
        if one.half_width
    }


def deck(
    analyses: Sequence[str],
    saved: Sequence[str],
    values: Mapping[str, float] | None = None,
    inputs: Mapping[str, str] | None = None,
    extra: Sequence[str] = (),
) -> str:
    """Return the text of a deck.

    `inputs`: sources of the nodes dac, ref, level, trim, enable, hold (source text, V) and push (A:
    N on the rotor). By default the board is on, at rest, and commands 0 N.
    """
    driven = {**INPUTS, "enable": "1", "hold": "1", **(inputs or {})}
    push = driven.pop("push", "0")
    unknown = set(values or {}) - set(VALUES)
    if unknown:
        raise KeyError(f"no value of the circuit: {sorted(unknown)}; values.inc has them all")
    return "\n".join(
        [
            "* active electrical damping",
            f".include {FOLDER / 'values.inc'}",
            *(f".param {name} = {float(value)!r}" for name, value in (values or {}).items()),
            f".include {FOLDER / 'circuit.cir'}",
            *(f"V{node} {node} 0 {text}" for node, text in driven.items()),
            f"Ipush 0 rotor {push}",
            OPTIONS,
            f".save {' '.join(saved)}",
            *extra,
            *analyses,
            ".end\n",
        ]
    )


def run(text: str) -> list[Waves]:
    """Return the plots of a deck in the order of its analyses: arrays (points,) by name.
    NgspiceError.
    """
    with tempfile.TemporaryDirectory(prefix="circuit-") as folder:
        source = Path(folder) / "deck.cir"
        raw = Path(folder) / "deck.raw"
        source.write_text(text)
        done = subprocess.run(
            ["ngspice", "-b", "-r", str(raw), str(source)],
            capture_output=True,
            text=True,
            timeout=RUN_S,
            check=False,
        )
        said = done.stdout + done.stderr
        if done.returncode or not raw.exists() or any(sign in said for sign in FAILED):
            raise NgspiceError(said[-4000:])
        return _plots(raw.read_bytes())


def _plots(content: bytes) -> list[Waves]:
    """Parse a binary raw file: header lines, then points x variables of doubles or
    complex doubles.
    """
    plots = []
    while content:
        head, _, content = content.partition(b"Binary:\n")
        lines = head.decode().splitlines()
        fields = dict(line.split(":", 1) for line in lines if ":" in line and line[0] != "\t")
        names = [line.split("\t")[2] for line in lines if re.match(r"\t\d+\t", line)]
        kind = np.complex128 if "complex" in fields["Flags"] else np.float64
        shape = (int(fields["No. Points"]), len(names))
        size = shape[0] * shape[1] * np.dtype(kind).itemsize
        table = np.frombuffer(content[:size], kind).reshape(shape)
        plots.append(dict(zip(names, table.T, strict=True)))
        content = content[size:]
    return plots
