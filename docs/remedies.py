"""Update docs/remedies.md with runs of `hapticd studies remedies`: `python docs/remedies.py
build/remedies`, with one folder or several for different devices.

The rows are kept in docs/figures/remedies.json, and the tables of the page are made from them. The
text is written by hand. Without a folder the kept rows fill the page again. A run without trials
(`--seeds 0`) updates only the energies at the port.
"""

import json
import sys
from math import atan2, degrees, hypot
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS)]

from pages.markdown import replaced, table  # noqa: E402

PAGE = DOCS / "remedies.md"
KEPT = DOCS / "figures" / "remedies.json"
HEADINGS = (
    "remedy", "corner Hz", "K at B = 0", "best B", "K at best B", "volume",
    "Z over asked at 5, 30, 100 Hz", "noise mN", "K predicted", "K by trials",
)  # fmt: skip
ENERGY_HEADINGS = (
    "remedy", "its number", "best B", "K in every hand", "K by the theorem", "mJ given out at 2 K",
)  # fmt: skip
Rows = list[dict[str, Any]]


def cell(value: float | None, digits: int = 3) -> str:
    """Return a number to three digits; "-" if there is none."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.{digits}g}"


def gained(value: float | None, before: float | None) -> str:
    """Return a number, and in brackets its ratio to the first row's."""
    if value is None or not before or value == before:
        return cell(value)
    return f"{cell(value)} ({cell(value / before)}x)"


def over_asked(pairs: list[list[float]]) -> str:
    """Return magnitude and phase of each ratio."""
    shown = [(cell(hypot(re, im)), round(degrees(atan2(im, re)))) for re, im in pairs]
    return ", ".join(f"{size} at {phase}°" for size, phase in shown)


def tried(trials: dict[str, Any] | None) -> str:
    """Return the limit by trials with its scatter between seeds and its interval."""
    if trials is None or trials["value"] is None:
        return "-"
    scatter = "" if trials["sd"] is None else f" ± {cell(trials['sd'], 2)}"
    return f"{cell(trials['value'])}{scatter} [{cell(trials['lower'])}, {cell(trials['upper'])}]"


def line(row: dict[str, Any], first: dict[str, Any]) -> tuple[str, ...]:
    """Return one remedy of a device whose first row is `first`."""
    return (
        row["remedy"],
        cell(row["corner_hz"]),
        gained(row["stiffness_alone_n_per_m"], first["stiffness_alone_n_per_m"]),
        cell(row["virtual_damping_ns_per_m"]),
        gained(row["stiffness_n_per_m"], first["stiffness_n_per_m"]),
        gained(row["volume"], first["volume"]),
        over_asked(row["rendered"]),
        cell(None if row["noise_n"] is None else 1e3 * row["noise_n"]),
        cell((row["trials"] or {"scan": {"predicted": None}})["scan"]["predicted"]),
        tried(row["trials"]),
    )


def energy_line(
    row: dict[str, Any], first: dict[str, Any], theory: dict[str, Any] | None
) -> tuple[str, ...]:
    """Return the row of a remedy by the energy at the port; `theory`: its row by the theorem."""
    given = "diverged" if row["diverged"] else cell(1e3 * row["given_out_j"], 2)
    by_theorem = cell(theory["stiffness_n_per_m"]) if theory else "none"
    return (
        row["remedy"],
        cell(row["number"]),
        cell(row["virtual_damping_ns_per_m"]),
        gained(row["stiffness_n_per_m"], first["stiffness_n_per_m"]),
        by_theorem,
        given,
    )


def with_energies(page: str, energies: Rows, rows: Rows) -> str:
    """Return the page with a table of energies for each device, and one of K for all."""
    theory = {(row["device"], row["remedy"]): row for row in rows}
    devices = list(dict.fromkeys(row["device"] for row in energies))
    columns = []
    for device in devices:
        own = [row for row in energies if row["device"] == device]
        lines = [energy_line(row, own[0], theory.get((device, row["remedy"]))) for row in own]
        page = replaced(page, f"remedies energy {device}", table(ENERGY_HEADINGS, lines))
        columns.append([line[3] for line in lines])
    names = [row["remedy"] for row in energies if row["device"] == devices[0]]
    limits = table(("remedy", *devices), list(zip(names, *columns, strict=True)))
    return replaced(page, "remedies energy", limits)


def filled(page: str, rows: Rows, energies: Rows) -> str:
    """Return the page with a table of K for all devices, and one of everything for each."""
    page = with_energies(page, energies, rows)
    devices = list(dict.fromkeys(row["device"] for row in rows))
    columns = []
    for device in devices:
        own = [row for row in rows if row["device"] == device]
        lines = [line(row, own[0]) for row in own]
        page = replaced(page, f"remedies {device}", table(HEADINGS, lines))
        columns.append([line[4] for line in lines])
    names = [row["remedy"] for row in rows if row["device"] == devices[0]]
    gains = table(("remedy", *devices), list(zip(names, *columns, strict=True)))
    return replaced(page, "remedies stiffness", gains)


def kept(part: str = "rows") -> Rows:
    """Return the rows of the present page: "rows", or "energy" for those of the port."""
    return list(json.loads(KEPT.read_text())[part])


def main(folders: list[str]) -> None:
    """Keep the rows of the runs, and fill the page."""
    runs = [json.loads((Path(folder) / "run.json").read_text()) for folder in folders]
    if runs:
        about: dict[str, Any] = {}
        if runs[0]["seeds"]:
            about = {name: runs[0][name] for name in ("quick", "seconds", "seeds")}
            about["rows"] = [row for run in runs for row in run["rows"]]
        about["energy"] = [row for run in runs for row in run["energy"]]
        kept_before = json.loads(KEPT.read_text())
        KEPT.write_text(json.dumps(kept_before | about, indent=1) + "\n")
    PAGE.write_text(filled(PAGE.read_text(), kept(), kept("energy")))


if __name__ == "__main__":
    main(sys.argv[1:])
