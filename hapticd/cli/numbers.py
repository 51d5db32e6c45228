"""Numbers as people type them, and what to type where they are none.

A unit, a decimal comma and a name in place of a symbol are the usual mistakes. The message has the
corrected word where there is one reading only: 100N/m is 100 where N/m is the unit, and 10g is no
mass in kg.
"""

import math
import re
from typing import Any

import typer
from typer.core import TyperCommand

from hapticd.mailbox.layout import VALUE_LIMITS
from hapticd.protocol.limits import PLACES

SYMBOLS = {  # what people call a parameter
    "stiffness": "K",
    "spring": "K",
    "virtual_damping": "B",
    "viscosity": "B",
    "viscous": "B",
    "mass": "M",
    "virtual_mass": "M",
    "inertia": "M",
    "damping": "active_damping",  # as the verb `damping` means it
}
NO_UNITS = ("1", "side")
_WITH_UNIT = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.,].*)")
_WITH_COMMA = re.compile(r"([-+]?\d*),(\d+)")
_THOUSAND = 3  # digits after a comma that may separate thousands


class Mistyped(typer.BadParameter):
    """A word that is no value; `detail` is for programs, with the word to type as its remedy."""

    def __init__(self, message: str, name: str, value: str, unit: str, remedy: str | None) -> None:
        super().__init__(message)
        self.detail = {"loc": name, "value": value, "unit": unit, "remedy": remedy}


def number(name: str, text: str, expected: str = "a number", joint: str = "=") -> int | float:
    """`text` as int or float, finite; Mistyped for others. People type NAME `joint` VALUE."""
    try:
        value = float(text)
    except ValueError:
        raise _mistyped(name, text, expected, joint) from None
    unit = unit_of(name)
    if not math.isfinite(value):
        in_unit = f", in {unit}" if unit else ""
        raise Mistyped(
            f"{name}: {shortened(text)} is not a finite number{in_unit}", name, text, unit, None
        )
    return int(text) if text.strip().lstrip("+-").isdecimal() else value


def unit_of(name: str) -> str:
    """The unit of parameter `name`; empty without one."""
    unit = VALUE_LIMITS[PLACES["active_damping" if name == "damping" else name]].unit
    return "" if unit in NO_UNITS else unit


def shortened(text: str, most: int = 40) -> str:
    """`text` in quotes, cut where it is long."""
    return repr(text if len(text) <= most else f"{text[:most]}...")


def _mistyped(name: str, text: str, expected: str, joint: str) -> Mistyped:
    unit = unit_of(name)
    value, advice = _meant(text, unit)
    remedy = f"{name}{joint}{value}" if value else None
    advice += f": {remedy}" if remedy else ""
    message = f"{name}: {shortened(text)} is not {expected}{advice}"
    return Mistyped(message, name, text, unit, remedy)


def _meant(text: str, unit: str) -> tuple[str, str]:
    """The number that `text` certainly means, else nothing; and what to do."""
    if comma := _WITH_COMMA.fullmatch(text):
        if len(comma[2]) == _THOUSAND and comma[1].lstrip("+-") not in ("", "0"):
            return "", "; write a decimal point, not a comma"
        return f"{comma[1]}.{comma[2]}", "; write a decimal point"
    if unit and (found := _WITH_UNIT.fullmatch(text)):
        same = _plain(found[2]) == _plain(unit)
        return found[1] if same else "", f"; write it in {unit}, without unit"
    return "", ""


def _plain(unit: str) -> str:
    return re.sub(r"[\s*·]", "", unit)


def unknown(name: str, value: str, names: tuple[str, ...]) -> Mistyped:
    """The error for a parameter that there is not, with the one that was meant."""
    from hapticd.settings.toml import nearest

    meant = SYMBOLS.get(name.lower().replace("-", "_")) or nearest(name, names)
    asked = f"; did you mean {meant!r}?" if meant else ""
    message = f"{shortened(name)} is unknown{asked}; see `hapticd set --help`"
    return Mistyped(message, name, name, "", f"{meant}={value}" if meant else None)


class SignedLevel(TyperCommand):
    """A verb whose argument may be below zero: -1 is a number, and not an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """The words, numbers with a sign put behind `--`."""
        signed = [
            place
            for place, word in enumerate(args)
            if _is_signed(word) and args[:place][-1:] != ["--instance"]
        ]
        if signed and "--" not in args:
            others = [word for place, word in enumerate(args) if place not in signed]
            args = [*others, "--", *(args[place] for place in signed)]
        return super().parse_args(ctx, args)


def _is_signed(word: str) -> bool:
    try:
        return word.startswith("-") and not math.isnan(float(word))
    except ValueError:
        return False
