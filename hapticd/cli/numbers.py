"""Numbers typed by people, with corrections for typing mistakes.

A unit, a decimal comma and a name in place of a symbol are the usual mistakes. The message contains
the corrected text if there is only one interpretation: 100N/m is 100 where N/m is the unit, but 10g
is not a mass in kg.
"""

import math
import re
from typing import Any

import typer
from typer.core import TyperCommand

from hapticd.mailbox.layout import VALUE_LIMITS
from hapticd.protocol.limits import PLACES

SYMBOLS = {  # common names of parameters
    "stiffness": "K",
    "spring": "K",
    "virtual_damping": "B",
    "viscosity": "B",
    "viscous": "B",
    "mass": "M",
    "virtual_mass": "M",
    "inertia": "M",
    "damping": "active_damping",  # in the sense of the verb `damping`
}
NO_UNITS = ("1", "side")
_WITH_UNIT = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.,].*)")
_WITH_COMMA = re.compile(r"([-+]?\d*),(\d+)")
_THOUSAND = 3  # digits after a comma that may separate thousands


class Mistyped(typer.BadParameter):
    """An argument that is not a value; `detail` is for programs, with the corrected text as its
    remedy.
    """

    def __init__(self, message: str, name: str, value: str, unit: str, remedy: str | None) -> None:
        super().__init__(message)
        self.detail = {"loc": name, "value": value, "unit": unit, "remedy": remedy}


def number(name: str, text: str, expected: str = "a number", joint: str = "=") -> int | float:
    """Return `text` as int or float, finite; otherwise Mistyped. The user types NAME
    `joint` VALUE.
    """
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
    """Return the unit of parameter `name`; empty without one."""
    unit = VALUE_LIMITS[PLACES["active_damping" if name == "damping" else name]].unit
    return "" if unit in NO_UNITS else unit


def shortened(text: str, most: int = 40) -> str:
    """Return `text` in quotes, shortened if it is long."""
    return repr(text if len(text) <= most else f"{text[:most]}...")


def _mistyped(name: str, text: str, expected: str, joint: str) -> Mistyped:
    unit = unit_of(name)
    value, advice = _meant(text, unit)
    remedy = f"{name}{joint}{value}" if value else None
    advice += f": {remedy}" if remedy else ""
    message = f"{name}: {shortened(text)} is not {expected}{advice}"
    return Mistyped(message, name, text, unit, remedy)


def _meant(text: str, unit: str) -> tuple[str, str]:
    """Return the unambiguous number in `text`, otherwise an empty text; and the remedy."""
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
    """Return the error for an unknown parameter, with the closest known one."""
    from hapticd.settings.toml import nearest

    meant = SYMBOLS.get(name.lower().replace("-", "_")) or nearest(name, names)
    asked = f"; did you mean {meant!r}?" if meant else ""
    message = f"{shortened(name)} is unknown{asked}; see `hapticd set --help`"
    return Mistyped(message, name, name, "", f"{meant}={value}" if meant else None)


class SignedLevel(TyperCommand):
    """A verb whose argument may be negative: -1 is a number, not an option."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments, with signed numbers moved behind `--`."""
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
