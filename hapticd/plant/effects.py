"""The base of every effect: a frozen value that says why it exists, where its numbers come from, and what it adds.

An effect is one table of a device file ([model.KEY]). Its parameters are its fields, with the unit in the name; every
number carries one of three tags: paper (printed by Weir, Colgate and Peshkin 2008), inferred (from other known facts or
from good practice), calibrated (fitted so that the device reproduces the paper's limits).
"""

from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar

from hapticd.plant.blueprint import Blueprint
from hapticd.plant.parts import Note
from hapticd.units import unit_of

PROVENANCE = ("source", "sources", "note")


def number(default: Any = MISSING, **limits: float) -> Any:
    """A parameter with what is sensible for it: gt, ge, lt, le, as the readers of files enforce them."""
    return field(default=default, metadata=limits)


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """`source` tags all parameters but those named in `sources` (name, tag); `note` says more in words."""

    key: ClassVar[str]
    why: ClassVar[str]
    nonlinearity: ClassVar[str] = ""

    source: str = "inferred"
    sources: tuple[tuple[str, str], ...] = ()
    note: str = ""

    def build(self, plan: Blueprint) -> None:
        """Write states, forces, signals or nonlinearities into `plan`."""
        raise NotImplementedError

    def time_constants_s(self) -> tuple[float, ...]:
        """Its own time constants; those of the device as a whole are eigenvalues of the model."""
        return ()

    def parameters(self) -> tuple[tuple[str, float, str, str], ...]:
        """(name, value, unit, tag) of every number."""
        tags = dict(self.sources)
        numbers = [item.name for item in fields(self) if item.name not in PROVENANCE]
        return tuple((name, getattr(self, name), unit_of(name), tags.get(name, self.source)) for name in numbers)

    def note_of(self, states: tuple[str, ...]) -> Note:
        """This effect in words, with the states that it added."""
        why = f"{self.why}; {self.note}" if self.note else self.why
        return Note(self.key, why, states, self.nonlinearity, self.time_constants_s(), self.parameters())
