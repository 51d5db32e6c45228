"""Update docs/remedies.md with runs of `hapticd studies remedies`: `python docs/remedies.py
build/remedies`, with one folder or several for different devices.

The rows are kept in docs/figures/remedies.json. The tables of the page and the figure
docs/figures/remedies.svg are made from them. The text is written by hand. Without a folder the kept
rows fill the page again. A run without trials (`--seeds 0`) keeps the trials of rows with the same
K and B.
"""

import json
import sys
from math import atan2, degrees, hypot, nan
from pathlib import Path
from typing import Any

import numpy as np

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

from pages.markdown import replaced, table  # noqa: E402

from hapticd.zwidth.report.style import (  # noqa: E402
    DEVICES,
    WIDTH_IN,
    Axes,
    Colour,
    axes,
    plain_axis,
    styled,
)

PAGE = DOCS / "remedies.md"
KEPT = DOCS / "figures" / "remedies.json"
FIGURE = DOCS / "figures" / "remedies.svg"
LOOKS = (*DEVICES, {"color": Colour.GREY, "marker": "D"}, {"color": Colour.FOREST, "marker": "v"})
SPREAD = 0.6  # of a line of the figure, over its devices
SHOWN = (0.3, 30.0)  # ratios in the figure
QUANTILES = (0.05, 0.5, 0.95)
HEADINGS = (
    "remedy", "corner Hz", "K at B = 0", "best B", "K at best B", "volume",
    "Z over asked at 5, 30, 100 Hz", "noise mN", "K predicted", "K by trials",
)  # fmt: skip
ENERGY_HEADINGS = (
    "remedy", "its number", "best B", "K in every hand", "K in a draw", "gain in a draw",
    "K by the theorem", "mJ given out at 2 K", "Z over asked at 5, 30, 100 Hz", "noise mN",
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
    if any(part is None for pair in pairs for part in pair):
        return "diverged"
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


def gains(row: dict[str, Any], first: dict[str, Any]) -> tuple[float, ...]:
    """Return quantiles of the ratio of K to the first row's over the draws of hands, which all rows
    share.
    """
    pairs = zip(row["draws_n_per_m"], first["draws_n_per_m"], strict=True)
    ratios = [own / other for own, other in pairs if other]
    return tuple(np.quantile(ratios, QUANTILES)) if ratios else (nan, nan, nan)


def over_draws(quantiles: tuple[float, ...], unit: str = "") -> str:
    """Return the median, and the interval in brackets."""
    low, middle, high = (cell(float(one)) for one in quantiles)
    return f"{middle}{unit} [{low}, {high}]"


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
        cell(row["stiffness_n_per_m"]),
        over_draws(tuple(np.quantile(row["draws_n_per_m"], QUANTILES))),
        over_draws(gains(row, first), "x"),
        by_theorem,
        given,
        over_asked(row["rendered"]),
        cell(None if row["noise_n"] is None else 1e3 * row["noise_n"]),
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
        columns.append([f"{line[3]}; {line[5]}" for line in lines])
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


def points(axis: Axes, found: dict[str, Rows], judged: str) -> None:
    """Draw a line for each remedy with the ratios of K of all devices; "draws" with intervals."""
    names = [row["remedy"] for row in next(iter(found.values()))][1:]
    for place, (device, rows) in enumerate(found.items()):
        lines = np.arange(len(names)) + SPREAD * ((place + 0.5) / len(found) - 0.5)
        if judged == "draws":
            low, middle, high = np.array([gains(row, rows[0]) for row in rows[1:]]).T
            axis.hlines(lines, np.maximum(low, 1e-3), high, color=LOOKS[place]["color"], lw=0.9)
        else:
            k = np.array([row["stiffness_n_per_m"] or nan for row in rows])
            middle = k[1:] / k[0]
        shown = np.maximum(middle, SHOWN[0])  # nan stays nan
        axis.plot(shown, lines, linestyle="", **LOOKS[place], label=device, clip_on=False)
    axis.axvline(1.0, color=Colour.GREY, linewidth=0.8)
    axis.set(xscale="log", xlim=SHOWN, xlabel="K over that of the first row")
    axis.set(ylim=(len(names) - 0.5, -0.5), yticks=range(len(names)), yticklabels=names)
    plain_axis(axis.xaxis)


@styled()
def draw(rows: Rows, energies: Rows) -> None:
    """Draw the gains by the theorem, and by the energy in hands."""
    figure, panels = axes(1, 2, WIDTH_IN, 5.8)
    for axis, part, judged in zip(panels, (rows, energies), ("theorem", "draws"), strict=True):
        devices = dict.fromkeys(row["device"] for row in part)
        points(
            axis, {one: [row for row in part if row["device"] == one] for one in devices}, judged
        )
    panels[0].set(title="by the theorem")
    panels[1].set(title="by energy in hands")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names))
    figure.savefig(FIGURE, metadata={"Date": None})


def with_trials(rows: Rows, before: Rows) -> Rows:
    """Return the rows with the trials of equal rows before, where they have none."""
    same = ("device", "remedy", "virtual_damping_ns_per_m", "stiffness_n_per_m")
    known = {tuple(row[name] for name in same): row["trials"] for row in before}
    return [
        row | {"trials": row["trials"] or known.get(tuple(row[name] for name in same))}
        for row in rows
    ]


def main(folders: list[str]) -> None:
    """Keep the rows of the runs, and fill the page."""
    runs = [json.loads((Path(folder) / "run.json").read_text()) for folder in folders]
    if runs:
        about: dict[str, Any] = json.loads(KEPT.read_text())
        if runs[0]["seeds"]:
            about |= {name: runs[0][name] for name in ("quick", "seconds", "seeds")}
        about["rows"] = with_trials([row for run in runs for row in run["rows"]], about["rows"])
        about["energy"] = [row for run in runs for row in run["energy"]]
        KEPT.write_text(json.dumps(about, indent=1) + "\n")
    PAGE.write_text(filled(PAGE.read_text(), kept(), kept("energy")))
    draw(kept(), kept("energy"))


if __name__ == "__main__":
    main(sys.argv[1:])
