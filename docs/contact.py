"""Active damping where it is needed: the K-B plot of a wall, and what a hand feels before the wall.
`python docs/contact.py` fills the section of that name of docs/remedies.md; about ten minutes on
two cores. Ctrl-C is safe: the same command continues with the remaining rows.

A variant (`Variant`) is a level of active damping everywhere, or one that follows a wall
(`zwidth.engine.contact`). For each device and variant a row has, over B between 0 and the largest
that the whole level permits:

    permitted   the first failure of K from 0 on by the guard's criterion, the theorem without dry
                friction, along the whole way: every share of the wall at its level, and free motion
                at every level
    by impact   the stiffest wall that an impact does not set swinging (`zwidth.walls`): the bare
                device is pushed against it, from DISTANCE_M before it

and, for one wall at the B with the largest permitted K:

    depth       the deepest that the impact goes into half of what the whole level permits, if that
                wall is stable: one that is late is soft at first
    given out   the most that a passive hand of a family (`studies.port_energy`) gets from the
                permitted wall, pushed against it: the theorem does not cover the contact, nor a
                share that changes
    drag        |Z| of the display in free motion at DRAG_HZ, before the approach

The rows are kept in docs/figures/contact.json. Limitations: those of `studies.port_energy`.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]

from pages.markdown import replaced, table  # noqa: E402
from remedies import PAGE, cell  # noqa: E402

from hapticd import __version__  # noqa: E402
from hapticd.core.arrays import Flags, Floats  # noqa: E402
from hapticd.core.environment import Environment, WallParams  # noqa: E402
from hapticd.core.units import PROBE_RATE_HZ  # noqa: E402
from hapticd.guard.safe_region import SafeRegion  # noqa: E402
from hapticd.model.bases import Theorem  # noqa: E402
from hapticd.model.coupled import at_port  # noqa: E402
from hapticd.model.predict import predicted_impedance  # noqa: E402
from hapticd.model.scene import Excitation, Scene  # noqa: E402
from hapticd.settings.scene import load_scene  # noqa: E402
from hapticd.studies.port_energy import SECONDS, drawn, hand_of, pushed_n  # noqa: E402
from hapticd.zwidth.engine.batch import simulate  # noqa: E402
from hapticd.zwidth.engine.contact import ContactDamping  # noqa: E402
from hapticd.zwidth.limits import REACH  # noqa: E402
from hapticd.zwidth.passive_set import axis_limit  # noqa: E402
from hapticd.zwidth.report.style import WIDTH_IN, Colour, axes, styled  # noqa: E402
from hapticd.zwidth.sources import SUBSTEPS, display  # noqa: E402
from hapticd.zwidth.store import TrialStore, fingerprint, to_json  # noqa: E402
from hapticd.zwidth.walls import WallMapParams, WallPlan, hit, plan_walls, run_walls  # noqa: E402

KEPT = DOCS / "figures" / "contact.json"
FIGURE = DOCS / "figures" / "contact.svg"
LOOKS = (
    (Colour.BLACK, "-"),
    (Colour.BLUE, "-"),
    (Colour.ORANGE, "--"),
    (Colour.PURPLE, "--"),
    (Colour.GREEN, ":"),
)
TRIALS = DOCS.parent / "build" / "contact" / "trials.jsonl"
SCENES = ("fig4", "median")
LEVEL_NS_PER_M = 1.74
DRAG_HZ = (5.0, 30.0)
DISTANCE_M = 0.006  # from the start to the wall
IMPACT_S = 2.0
START_M_PER_S = 0.1
STEPS = 8  # of B, shorter towards 0
HANDS = 128
WAY = 9  # shares of the wall, with 0 and 1
FINEST = 20  # steps of each of the three passes to the permitted K
STIFFNESS = np.geomspace(0.05, 3.0, 12)  # over the largest permitted K, of impacts


HEADINGS = (
    "active damping", "best B", "K permitted", "K by impact", "depth mm", "mJ given out",
    "drag at 5 Hz", "at 30 Hz",
)  # fmt: skip
Rows = list[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Variant:
    """Active damping of a wall: `rule` with the study's level at the wall, or everywhere."""

    name: str
    on: bool = True
    rule: ContactDamping | None = None


VARIANTS = (
    Variant("none", on=False),
    Variant("everywhere"),
    Variant("from 5 mm on, 20 N s/m/s", rule=ContactDamping(0.005, 20.0)),
    Variant("from the surface on, 2,000 N s/m/s", rule=ContactDamping(0.0, 2000.0)),
    Variant("from 1 mm on, 2,000 N s/m/s", rule=ContactDamping(0.001, 2000.0)),
)


@dataclass(frozen=True)
class Judged:
    """A device with one level and rule, and the guard's region."""

    scene: Scene
    level_ns_per_m: float
    rule: ContactDamping | None
    region: SafeRegion

    @property
    def free_ns_per_m(self) -> float:
        """Active damping in free motion."""
        return self.level_ns_per_m if self.rule is None else self.rule.free_ns_per_m

    def walled(self, point: Sequence[float], share: float = 1.0) -> Environment:
        """Return a share of a wall with K, B (N/m, N s/m), alone, at its level."""
        velocity, acceleration = self.scene.environment.filters
        level = self.free_ns_per_m + share * (self.level_ns_per_m - self.free_ns_per_m)
        return Environment(
            velocity_filter=velocity,
            acceleration_filter=acceleration,
            wall=WallParams(share * point[0], share * point[1], DISTANCE_M, 1),
            active_damping_ns_per_m=level,
        )

    def permitted(self, points: Floats) -> Flags:
        """Return whether walls (N, 3) are safe at every share of the way."""
        shares = [1.0] if self.rule is None else np.linspace(0.0, 1.0, WAY)
        way = [self.walled(point, float(share)) for point in points for share in shares]
        return np.array(self.region.safe(way)).reshape(len(points), -1).all(axis=1)

    def stiffest(self, virtual_damping_ns_per_m: float, most_n_per_m: float) -> float:
        """Return the first K [N/m] that is not permitted at that B; nan if K = 0 is not."""
        base = (0.0, virtual_damping_ns_per_m, 0.0)
        return axis_limit(self.permitted, 0, most_n_per_m, base, FINEST)

    def walls(self, stiffnesses: Floats, virtual_damping: Floats) -> WallPlan:
        """Return the plan of impacts."""
        scene = replace(
            self.scene,
            environment=self.walled((1.0, 0.0)),
            excitation=Excitation("push", force_n=0.5 * pushed_n(self.scene)),
            seconds=IMPACT_S,
            start_velocity_m_per_s=START_M_PER_S,
        )
        levels = (self.level_ns_per_m,)
        asked = tuple(stiffnesses.tolist()), tuple(virtual_damping.tolist())
        return plan_walls(WallMapParams(scene, *asked, levels, contact=self.rule))

    def given_out_j(self, point: tuple[float, float], count: int) -> float:
        """Return the most that one of `count` hands gets [J], pushed against the wall K, B; nan if
        the motion diverges in one.
        """
        model = display(self.scene).model
        rule = self.rule and self.rule.at(self.level_ns_per_m)
        push = np.full(round(SECONDS * PROBE_RATE_HZ), pushed_n(self.scene))
        found = 0.0
        for sizes in drawn(1, count):
            trial = simulate(
                at_port(model, hand_of(sizes)),
                [[0.0, 0.0, 0.0]],
                SECONDS,
                active_damping=self.level_ns_per_m,
                environment=self.walled(point),
                excitation=push,
                substeps=SUBSTEPS,
                contact=rule,
            )
            found = max(found, inf if trial.diverged[0] else -float(trial.min_energy_j[0]))
        return found if found < inf else nan

    def drag(self) -> tuple[float, ...]:
        """Return |Z| [N s/m] in free motion at DRAG_HZ."""
        shown = display(self.scene)
        z = predicted_impedance(
            shown.model,
            (0.0, 0.0, 0.0),
            np.array(DRAG_HZ),
            self.free_ns_per_m,
            shown.filters,
            recorded=False,
        )
        return tuple(np.abs(z).tolist())


def judged(scene: Scene, variant: Variant) -> dict[str, Any]:
    """Return the row of a variant; K and B are spread over what the level everywhere permits."""
    model = display(scene).model
    region = SafeRegion(Theorem(model), (model.delay_periods,), 0.0)
    whole = Judged(scene, LEVEL_NS_PER_M, None, region)
    highest_b = axis_limit(whole.permitted, 1, REACH[1], steps=FINEST)
    b = highest_b * (np.arange(STEPS) / STEPS) ** 2
    most_k = float(np.nanmax([whole.stiffest(each, REACH[0]) for each in b]))
    one = Judged(scene, LEVEL_NS_PER_M * variant.on, variant.rule, region)
    permitted = np.array([one.stiffest(each, 1.5 * most_k) for each in b])
    best = int(np.argmax(np.nan_to_num(permitted, nan=-1.0)))
    plan = one.walls(STIFFNESS * most_k, b)
    impact = hit(plan, one.level_ns_per_m, 0.5 * most_k, float(b[best]))
    return {
        "device": scene.name,
        "variant": variant.name,
        "virtual_damping_ns_per_m": b,
        "permitted_n_per_m": permitted,
        "by_impact_n_per_m": [line.highest_n_per_m for line in run_walls(plan).lines],
        "best": best,
        "asked_n_per_m": 0.5 * most_k,
        "deepest_m": impact.deepest_m if impact.stable else nan,
        "given_out_j": one.given_out_j((permitted[best], b[best]), HANDS),
        "drag_ns_per_m": one.drag(),
    }


def run_study(store: TrialStore) -> Rows:
    """Return the rows of all devices and variants; those in the store are not computed again."""
    found = []
    for scene in map(load_scene, SCENES):
        for variant in VARIANTS:
            key = fingerprint((__version__, scene, variant, LEVEL_NS_PER_M, STEPS, HANDS))
            if key not in store.known:
                sys.stderr.write(f"{scene.name}, active damping: {variant.name}\n")
                store.add([(key, to_json(judged(scene, variant)))])
            found.append(dict(store.known[key]))
    return found


# --- the section of the page ----------------------------------------------------------------------


def line(row: dict[str, Any]) -> tuple[str, ...]:
    """Return a variant at the B with its largest permitted K."""
    best = row["best"]
    per_mille = (row["deepest_m"], row["given_out_j"])
    return (
        row["variant"],
        cell(row["virtual_damping_ns_per_m"][best]),
        cell(row["permitted_n_per_m"][best]),
        cell(row["by_impact_n_per_m"][best]),
        *(cell(None if value is None else 1e3 * value) for value in per_mille),
        *(cell(value) for value in row["drag_ns_per_m"]),
    )


def plot(rows: Rows) -> str:
    """Return the K-B plot of a device as a table: K by impact, and K permitted in brackets."""
    dampings = rows[0]["virtual_damping_ns_per_m"]
    columns = [
        [
            f"{cell(impact)} ({cell(permitted)})"
            for impact, permitted in zip(
                row["by_impact_n_per_m"], row["permitted_n_per_m"], strict=True
            )
        ]
        for row in rows
    ]
    lines = list(zip(map(cell, dampings), *columns, strict=True))
    return table(("B", *(row["variant"] for row in rows)), lines)


def filled(page: str, rows: Rows) -> str:
    """Return the page with two tables for each device."""
    for device in dict.fromkeys(row["device"] for row in rows):
        own = [row for row in rows if row["device"] == device]
        page = replaced(page, f"contact {device}", table(HEADINGS, [line(row) for row in own]))
        page = replaced(page, f"contact plot {device}", plot(own))
    return page


def kept() -> Rows:
    """Return the rows of the present section."""
    return list(json.loads(KEPT.read_text())["rows"])


@styled()
def draw(rows: Rows) -> None:
    """Draw the K-B plot of each device: K by impact."""
    figure, panels = axes(1, len(SCENES), WIDTH_IN, 3.2)
    for axis, device in zip(panels, SCENES, strict=True):
        own = [row for row in rows if row["device"] == device]
        for row, (colour, dashes) in zip(own, LOOKS, strict=True):
            at = row["virtual_damping_ns_per_m"], row["by_impact_n_per_m"]
            axis.plot(*at, color=colour, linestyle=dashes, label=row["variant"])
        axis.set(title=device, xlabel="wall B [N s/m]", ylabel="K by impact [N/m]", ylim=(0, None))
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.savefig(FIGURE, metadata={"Date": None})


def main() -> None:
    """Run the study, keep its rows, fill the section, draw the figure."""
    about = {"level_ns_per_m": LEVEL_NS_PER_M, "seconds": SECONDS, "hands": HANDS}
    KEPT.write_text(json.dumps(about | {"rows": run_study(TrialStore(TRIALS))}, indent=1) + "\n")
    PAGE.write_text(filled(PAGE.read_text(), kept()))
    draw(kept())


if __name__ == "__main__":
    main()
