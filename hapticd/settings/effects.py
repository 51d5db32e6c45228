"""[model] of a device file: one table per effect, made from the effects themselves, so that each is described once.

    [model]
    effects = ["probe", "coulomb", ...]     what a live simulated board builds; a scene names its own
    [model.coulomb]
    rotor_n = 0.0293
    source = "calibrated"                   paper | inferred | calibrated; `sources` tags single numbers otherwise

Converters and limits are not repeated here: `encoder`, `force_dac`, `damping_dac`, `probe_adc` and `saturation` take their
numbers from the scales and limits of the same device file.
"""

from collections.abc import Iterable
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field, create_model

from hapticd.plant.effects import ALWAYS, BY_KEY, PROVENANCE, Effect
from hapticd.settings.quantities import Table

FROM_SCALES = ("encoder", "force_dac", "damping_dac", "probe_adc", "saturation")
Tag = Literal["paper", "inferred", "calibrated"]


class EffectTable(Table):
    """What every effect has beside its numbers."""

    source: Tag
    """Where its numbers come from."""
    sources: dict[str, Tag] = Field(default_factory=dict)
    """Numbers that come from elsewhere."""
    note: str = ""
    """What else is to be said."""


def _table(kind: type[Effect]) -> type[EffectTable]:
    numbers: dict[str, Any] = {}
    for item in fields(kind):
        if item.name not in PROVENANCE:
            default = ... if item.default is MISSING else item.default
            numbers[item.name] = (float, Field(default, **item.metadata))
    return create_model(kind.__name__, __base__=EffectTable, __doc__=kind.__doc__, **numbers)


TABLES = {key: _table(kind) for key, kind in BY_KEY.items() if key not in FROM_SCALES}


class _Tables(Table):
    def table(self, key: str) -> Any:
        """Of the effect `key`; None if the device has none."""
        return getattr(self, key)


if TYPE_CHECKING:

    class DeviceModel(_Tables):
        """The effects of a simulated device."""

        effects: tuple[str, ...]

else:
    DeviceModel = create_model(
        "DeviceModel",
        __base__=_Tables,
        __doc__="The effects of a simulated device.",
        effects=(
            tuple[str, ...],
            Field(strict=False, description="What a live board builds; masses and motor are always there."),
        ),
        **{key: (table, ...) if key in ALWAYS else (table | None, None) for key, table in TABLES.items()},
    )


def effects_of(model: DeviceModel, names: Iterable[str], scales: dict[str, Effect]) -> tuple[Effect, ...]:
    """The effects `names` with the numbers of `model`, those of converters from `scales`; always with masses and motor."""
    chosen = [*ALWAYS, *(name for name in names if name not in ALWAYS)]
    return tuple(scales[name] if name in FROM_SCALES else _effect(name, model.table(name)) for name in chosen)


def _effect(key: str, table: EffectTable) -> Effect:
    plain = table.model_dump()
    plain["sources"] = tuple(plain["sources"].items())
    return BY_KEY[key](**plain)
