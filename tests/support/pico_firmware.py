"""Images of the Pico's firmware for the emulator: the shipped one, variants by macros of its
config.h, and variants with a defect inserted into a copy of the sources.
"""

import atexit
import re
import shutil
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

from firmware_iface.pico.build import COMPILER, SOURCES, build
from hapticd.model.params import BoardParams
from support.boards import board_params
from support.pico_chip import UNIQUE_ID, PicoChip, Wiring
from support.pico_modules import needed

PIN = re.compile(r"^#define PIN_(\w+) (\d+)", re.MULTILINE)
CONFIG = re.compile(r"^#define (\w+) ([\d.]+)", re.MULTILINE)
NAMES = {  # of pins.h, in the emulator
    "ENCODER_A": "a",
    "ENCODER_B": "b",
    "DAC_SELECT": "select",
    "DAMPING_SELECT": "dampingSelect",
    "AMPLIFIER_ENABLE": "amplifier",
    "EMERGENCY_STOP": "stop",
    "AMPLIFIER_READY": "ready",
}
SPI_OF_DAC = 0
LACKS = ("probe", "interval_mean", "temperature")  # capabilities of the simulated board
Defines = tuple[tuple[str, str], ...]
Change = tuple[str, str, str]  # file, text, replacement


class Dacs(NamedTuple):
    """The parts that make torque and damping: rows of dac_parts.c, by their names in
    the emulator.
    """

    torque: str = "dac8563"
    damping: str = "dac8812"

    def defines(self) -> Defines:
        """The macros of config.h by which the firmware is for these parts."""
        return (("DAC_PART", self.torque.upper()), ("DAMPING_PART", self.damping.upper()))


AS_SHIPPED = Dacs()


def wiring(dacs: Dacs = AS_SHIPPED) -> Wiring:
    """The parts at the pins of pins.h."""
    found = {name: int(pin) for name, pin in PIN.findall((SOURCES / "pins.h").read_text())}
    pins = {ours: found[name] for name, ours in NAMES.items()}
    events = {f"event{bit}": found["EVENT_FIRST"] + bit for bit in range(found["EVENT_COUNT"])}
    return Wiring({**pins, **events, "spi": SPI_OF_DAC}, *dacs)


def pico_params(**changes: object) -> BoardParams:
    """Return the simulated board with the properties that the shipped image reports."""
    told = dict(CONFIG.findall((SOURCES / "config.h").read_text()))
    watchdog_ms = float(told["WATCHDOG_MS"])
    board = board_params(serial=UNIQUE_ID, lacks=LACKS, watchdog_ms=watchdog_ms)
    return replace(board, **changes)  # type: ignore[arg-type]


@cache
def image(defines: Defines = (), changes: tuple[Change, ...] = ()) -> Path:
    """The .uf2, built once in this process. AssertionError if a text to change is not there just
    once, or the compiler is missing.
    """
    needed(COMPILER)
    folder = Path(tempfile.mkdtemp(prefix="hapticd-pico-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    sources = SOURCES
    if changes:
        sources = folder / "sources"
        shutil.copytree(SOURCES, sources, ignore=shutil.ignore_patterns("__pycache__"))
        for change in changes:
            _apply(sources, change)
    return build(folder / "built", defines=dict(defines), sources=sources)


def _apply(sources: Path, change: Change) -> None:
    name, old, new = change
    text = (sources / name).read_text()
    assert text.count(old) == 1, f"{name} has {text.count(old)} times: {old}"
    (sources / name).write_text(text.replace(old, new))


def start_chip(built: Path | None = None, dacs: Dacs = AS_SHIPPED, chip_id: int = 0) -> PicoChip:
    """A board that has just got its supply; `close` it."""
    wired = wiring(dacs)
    return PicoChip(built or image(), replace(wired, chip_id=chip_id or wired.chip_id))
