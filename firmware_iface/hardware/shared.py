"""The circuit in lock-step with a program: libngspice, its inputs held between two moments.

ngspice chooses its own time steps. A breakpoint at each moment up to which the inputs are known
makes it stop there exactly. It waits there, in its own thread, until the next inputs are known. So
no result depends on a future input, and no step is rejected across a moment. The library holds one
circuit; a process runs one `Transient` at a time.

Limitations: inputs that change between moments, or a deck whose sources are not `external`.
"""

import ctypes
import tempfile
import threading
from collections.abc import Mapping, Sequence
from ctypes import CFUNCTYPE, POINTER, c_bool, c_char_p, c_double, c_int, c_void_p
from pathlib import Path
from typing import Any

from firmware_iface.hardware.netlist import NgspiceError

__all__ = ["LIBRARY", "Transient"]

LIBRARY = "libngspice.so.0"
WAIT_S = 100.0
NEAR_S = 1e-12


class _Value(ctypes.Structure):
    _fields_ = (
        ("name", c_char_p),
        ("real", c_double),
        ("imag", c_double),
        ("is_scale", c_bool),
        ("is_complex", c_bool),
    )


class _Values(ctypes.Structure):
    _fields_ = (("count", c_int), ("index", c_int), ("values", POINTER(POINTER(_Value))))


_SEND_CHAR = CFUNCTYPE(c_int, c_char_p, c_int, c_void_p)
_EXIT = CFUNCTYPE(c_int, c_int, c_bool, c_bool, c_int, c_void_p)
_SEND_DATA = CFUNCTYPE(c_int, POINTER(_Values), c_int, c_int, c_void_p)
_SEND_INIT = CFUNCTYPE(c_int, c_void_p, c_int, c_void_p)
_RUNNING = CFUNCTYPE(c_int, c_bool, c_int, c_void_p)
_SOURCE = CFUNCTYPE(c_int, POINTER(c_double), c_double, c_char_p, c_int, c_void_p)
_SYNC = CFUNCTYPE(c_int, c_double, POINTER(c_double), c_double, c_int, c_int, c_int, c_void_p)


class _Library:
    """The only instance in a process."""

    def __init__(self) -> None:
        self.running: Transient | None = None
        self.said: list[str] = []
        self.handle = ctypes.CDLL(LIBRARY)
        self.handle.ngSpice_SetBkpt.argtypes = [c_double]
        self.handle.ngSpice_SetBkpt.restype = c_bool
        self._kept: Sequence[Any] = (
            _SEND_CHAR(self._hear),
            _SEND_CHAR(lambda *_: 0),
            _EXIT(lambda *_: 0),
            _SEND_DATA(self._data),
            _SEND_INIT(lambda *_: 0),
            _RUNNING(self._ended),
            _SOURCE(self._source),
            _SYNC(lambda *_: 0),
        )
        hear, status, leave, data, init, ended, source, sync = self._kept
        self.handle.ngSpice_Init(hear, status, leave, data, init, ended, None)
        self._ident = c_int(0)
        self.handle.ngSpice_Init_Sync(source, source, sync, ctypes.byref(self._ident), None)

    def command(self, text: str) -> None:
        if self.handle.ngSpice_Command(text.encode()):
            raise NgspiceError(f"{text}: {self.said[-5:]}")

    def _hear(self, text: bytes, *_: Any) -> int:
        self.said.append(text.decode(errors="replace"))
        del self.said[:-50]
        return 0

    def _data(self, values: Any, *_: Any) -> int:
        if self.running is not None:
            found = values.contents
            row = (found.values[place].contents for place in range(found.count))
            self.running.accepted({one.name.decode(): float(one.real) for one in row})
        return 0

    def _source(self, voltage: Any, _: float, name: bytes, *__: Any) -> int:
        if self.running is not None:
            voltage[0] = self.running.inputs[name.decode().lower()]
        return 0

    def _ended(self, is_over: bool, *_: Any) -> int:
        if is_over and self.running is not None:
            self.running.over()
        return 0


_library: _Library | None = None


def _loaded() -> _Library:
    global _library
    if _library is None:
        _library = _Library()
    return _library


class Transient:
    """A transient run of `deck`, whose sources named in `inputs` are external. A context manager.

    `inputs` holds the volts (or A) of each source by its name; it may be changed between calls of
    `advance`. The deck's .tran has to begin at once (uic) and to end later than any call.
    """

    def __init__(self, deck: str, inputs: Mapping[str, float]) -> None:
        self.inputs = {name.lower(): value for name, value in inputs.items()}
        self.values: dict[str, float] = {}
        self._horizon_s = 0.0
        self._there = threading.Event()
        self._go = threading.Event()
        self._closing = False
        self._library = _loaded()
        self._library.running = self
        with tempfile.TemporaryDirectory(prefix="circuit-") as folder:
            path = Path(folder) / "deck.cir"
            path.write_text(deck)
            self._library.command(f"source {path}")
        self._begun = False

    def __enter__(self) -> "Transient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def advance(self, until_s: float) -> dict[str, float]:
        """Return the saved nodes at `until_s`, with constant inputs from now to then."""
        if not self._begun:
            self._begin()
        self._horizon_s = until_s
        self._there.clear()
        self._library.handle.ngSpice_SetBkpt(until_s)
        self._go.set()
        self._arrive()
        return self.values

    def _begin(self) -> None:
        """Start the run, which waits at its first point."""
        self._begun = True
        self._library.command("bg_run")
        self._arrive()

    def _arrive(self) -> None:
        if not self._there.wait(WAIT_S) or self._closing:
            said = self._library.said[-8:]
            raise NgspiceError(f"the run ended before {self._horizon_s} s: {said}")

    def accepted(self, values: dict[str, float]) -> None:
        """Receive one accepted point, from the thread of ngspice."""
        self.values = values
        if self._closing or values["time"] < self._horizon_s - NEAR_S:
            return
        self._go.clear()
        self._there.set()
        self._go.wait(WAIT_S)

    def over(self) -> None:
        """Note that the run has ended by itself."""
        self._closing = True
        self._there.set()

    def close(self) -> None:
        """End the run and release the library."""
        self._closing = True
        self._go.set()
        if self._begun:
            self._library.handle.ngSpice_Command(b"bg_halt")
        self._library.running = None
        self._library.command("remcirc")
        self._library.handle.ngSpice_Command(b"destroy all")
