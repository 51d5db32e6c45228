"""What was recorded, of whatever kind: columns on demand, records as they were, and the legs that can be flown again."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import msgpack
import numpy as np
from numpy.typing import NDArray

from hapticd.assembly.replay import Leg
from hapticd.errors import ConfigError
from hapticd.gateway.encode import ENERGIES
from hapticd.gateway.records import DTYPE, Records
from hapticd.mailbox.client_side import Noted
from hapticd.mailbox.layout import COMMAND_VALUES, LAYOUT_HASH
from hapticd.measure.recording.channels import LEFT_OUT
from hapticd.measure.recording.live import FLUSHED, ROWS
from hapticd.measure.recording.writer import GROUPS, REQUEST
from hapticd.params import ServoParams, from_plain

TEXT = "checkpoint_text"


class Recording:
    """`attributes` say where it comes from; `column(group, name)` reads one channel. Use it as a context manager."""

    def __init__(
        self, path: Path, attributes: Mapping[str, Any], groups: Mapping[str, Mapping[str, Any]], file: Any = None
    ) -> None:
        self.path, self.attributes, self._file = path, attributes, file
        self._groups = {name: group for name, group in groups.items() if name != FLUSHED}
        self.rows = {name: min(map(len, group.values()), default=0) for name, group in self._groups.items()}
        if FLUSHED in groups:  # a live file: see `live`
            counts = groups[FLUSHED][ROWS]
            newest = counts[-1].tolist() if len(counts) else [0] * counts.shape[1]
            self.rows = dict(zip(counts.attrs["groups"], newest, strict=True))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._file is not None:
            self._file.close()

    def names(self, group: str) -> list[str]:
        """The channels of `group`, in the order of the records, then those that were derived."""
        there = self._groups.get(group, {})
        known = [channel.name for channel in GROUPS.get(group, [])]
        return [name for name in known if name in there] + [name for name in there if name not in known]

    def column(self, group: str, name: str, begin: int = 0, end: int | None = None) -> NDArray[Any]:
        """Rows begin..end of a channel: (n,), raw frames (n, bytes)."""
        after, stored = self.rows[group] if end is None else min(end, self.rows[group]), self._groups[group][name]
        found = np.asarray(stored[begin:after])
        standing = max(0, after - max(begin, len(stored)))
        return np.concatenate([found, np.repeat(np.asarray(stored[-1:]), standing, axis=0)]) if standing else found

    def unit(self, group: str, name: str) -> str:
        """Unit of a channel; empty when it has none."""
        channel = next((one for one in GROUPS.get(group, []) if one.name == name), None)
        return channel.unit if channel else ""

    @property
    def params(self) -> ServoParams:
        """The servo's parameters."""
        return from_plain(ServoParams, json.loads(self.attributes["configuration"]), str(self.path))

    @property
    def missing(self) -> dict[str, int]:
        """Records that are missing, by stream."""
        streams, counts = self.column("gap", "stream"), self.column("gap", "missing")
        return {name: int(counts[streams == name.encode()].sum()) for name in ("servo", "probe")}

    def records(self, begin: int, end: int) -> Records:
        """Rows as the records they were. ConfigError: another version recorded them."""
        if self.attributes["layout"] != LAYOUT_HASH.hex():
            version = self.attributes.get("server_version", "another version")
            raise ConfigError(f"{self.path} was recorded by hapticd {version} with other records; replay it with that one")
        found = np.empty(end - begin, DTYPE)
        for name in DTYPE.names or ():
            if name == "energy_j":
                for place, part in enumerate(ENERGIES):
                    found[name][:, place] = self.column("servo", part, begin, end)
            elif DTYPE[name].kind == "V":
                found[name] = np.ascontiguousarray(self.column("servo", name, begin, end)).view(DTYPE[name]).ravel()
            else:
                found[name] = self.column("servo", "tick" if name == LEFT_OUT else name, begin, end)
        return found

    def legs(self) -> list[Leg]:
        """What can be flown again: for each stretch without a gap, from its first checkpoint on."""
        found = (self._leg(*stretch) for stretch in self._stretches())
        return [leg for leg in found if leg is not None]

    def _stretches(self) -> list[tuple[int, int, int]]:
        """(first row, row after the last, epoch) of consecutive ticks of one servo life."""
        tick, lives = self.column("servo", "tick"), self.column("life", "row")
        cuts = {0, len(tick), *lives.tolist(), *(np.flatnonzero(np.diff(tick) != 1) + 1).tolist()}
        edges = sorted(cuts)
        epochs = self.column("life", "epoch")[np.searchsorted(lives, edges[:-1], side="right") - 1]
        return [(first, after, int(epoch)) for first, after, epoch in zip(edges[:-1], edges[1:], epochs, strict=True)]

    def _leg(self, first: int, after: int, epoch: int) -> Leg | None:
        begin_tick, end_tick = int(self.column("servo", "tick", first, first + 1)[0]), 0
        end_tick = begin_tick + after - first
        breaks = [tick for one, tick in self._pairs("break") if one == epoch and begin_tick <= tick < end_tick]
        for (one, tick), state in zip(self._pairs("checkpoint"), self._states(), strict=False):
            if one == epoch and begin_tick <= tick < end_tick:
                end = min([end_tick, *(lost for lost in breaks if lost >= tick)])
                row = first + tick - begin_tick
                if end > tick:
                    return Leg(tick, state, self.records(row, row + end - tick), self._requests(epoch, tick, end))
        return None

    def _pairs(self, group: str) -> list[tuple[int, int]]:
        return list(zip(self.column(group, "epoch").tolist(), self.column(group, "tick").tolist(), strict=True))

    def _states(self) -> list[Any]:
        text, place, found = self.column(TEXT, "bytes").tobytes(), 0, []
        for length in self.column("checkpoint", "length").tolist():
            if place + length > len(text):  # cut off with the rest
                break
            found.append(msgpack.unpackb(text[place : place + length], strict_map_key=False))
            place += length
        return found

    def _requests(self, epoch: int, begin: int, end: int) -> list[Noted]:
        numbers = np.stack([self.column("request", name) for name in ("epoch", *REQUEST)], axis=1).tolist()
        values = np.stack([self.column("request", f"value_{place:02}") for place in range(COMMAND_VALUES)], axis=1).tolist()
        return [
            Noted(tick=row[0], seq=row[1], kind=row[2], actor=row[3], apply_tick=row[4], values=tuple(twenty))
            for (one, *row), twenty in zip(numbers, values, strict=True)
            if one == epoch and begin <= row[0] < end
        ]
