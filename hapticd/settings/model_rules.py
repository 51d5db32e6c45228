"""Rules between the effects of a device, and of those that somebody asks for."""

from collections.abc import Iterator, Sequence
from typing import Any

from hapticd.plant.effects import ALWAYS, BY_KEY
from hapticd.settings.device import Device
from hapticd.settings.effects import FROM_SCALES, TABLES
from hapticd.settings.meant import did_you_mean

Finding = tuple[tuple[str, ...], Any, str]  # key, value, what is wrong
NEEDS = {"heating": "winding"}  # an effect that changes what another one brings


def model_rules(device: Device) -> Iterator[Finding]:
    """What is wrong with the [model] of a device file."""
    model = device.model
    if model is None:
        return
    if device.plant is not None:
        yield ("plant",), None, "stands beside [model]; keep one of them"
    yield from chosen_rules(device, ("model", "effects"), model.effects)
    for key in TABLES:
        table = model.table(key)
        for name in () if table is None else table.sources:
            if name not in type(table).model_fields:
                hint = did_you_mean(name, list(type(table).model_fields))
                yield ("model", key, "sources"), name, f"is no number of this table{hint}"
    if model.table("coupling") is not None and model.table("masses").slider_kg == 0.0:
        yield ("model", "masses", "slider_kg"), 0.0, "must be more than 0.0 kg: [model.coupling] needs something to couple"
    ends = model.table("ends")
    if ends is not None and ends.lower_m >= ends.upper_m:
        yield ("model", "ends", "upper_m"), ends.upper_m, f"must be more than lower_m = {ends.lower_m} m"


def chosen_rules(device: Device, path: tuple[str, ...], names: Sequence[str]) -> Iterator[Finding]:
    """What is wrong with the list `names` of effects to build, which stands at `path`."""
    if device.model is None:
        yield path, None, f"device {device.name!r} has no [model] that effects could be taken from"
        return
    for place, name in enumerate(names):
        if name not in BY_KEY:
            yield path, name, f"is no effect{did_you_mean(name, list(BY_KEY))}; known: {', '.join(BY_KEY)}"
        elif name in ALWAYS:
            yield path, name, "is always built; leave it out"
        elif name in names[:place]:
            yield path, name, "is named twice"
        elif name not in FROM_SCALES and device.model.table(name) is None:
            yield path, name, f"device {device.name!r} has no table [model.{name}]; add it or leave the effect out"
        elif name in NEEDS and NEEDS[name] not in names:
            yield path, name, f"needs the effect {NEEDS[name]!r}; add it"
