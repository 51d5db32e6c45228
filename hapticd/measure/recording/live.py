"""The live file: columns that grow by blocks, single writer, multiple readers (SWMR).

Fifty columns more than ten times a second would cost more than a recorder may take, so
- HDF5's low-level calls are used, with number types and selections made once (a fifth of the time);
- a column that stands still is not written: it stays shorter than the others until it moves or the file is closed.
How many rows count is written last, in /flushed/rows, after everything else has been handed over: whatever lies beyond is not
meant, and a column that ends before repeats its last value. A write that fails leaves the library with data it cannot put
anywhere; then nothing more is written, and the file stays as it was at the last flush for `recover`.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapticd.errors import HapticdError
from hapticd.measure.recording.channels import Channel
from hapticd.measure.recording.libraries import needed

CHUNK_ROWS = {"servo": 1024, "probe": 4096, "checkpoint_text": 4096}  # a chunk is written whole
FEW_ROWS = 64  # in a chunk of all others
FLUSHED, ROWS = "flushed", "rows"
SUFFIX = ".part.h5"


class Column:
    """One dataset that grows."""

    def __init__(self, group: Any, channel: Channel, chunk_rows: int) -> None:
        self._row = (channel.width,) if channel.width else ()
        self._dtype = np.dtype(channel.kind)
        self._bytes = self._dtype.itemsize * max(1, channel.width)
        self.dataset = group.create_dataset(
            channel.name, (0, *self._row), self._dtype, maxshape=(None, *self._row), chunks=(chunk_rows, *self._row)
        )
        self.dataset.attrs["units"] = channel.unit
        self._identifier, self._kind = self.dataset.id, self.dataset.id.get_type()
        self._last, self._standing, self._rows = b"", 0, 0

    def append(self, values: NDArray[Any], selected: "Selections") -> None:
        """Add `values`, of the bytes of the dataset's number type; nothing is written while all are what the last one was."""
        data = values.tobytes()
        if data == self._last * len(values):
            self._standing += len(values)
        else:
            self._write(self._last * self._standing + data, selected)

    def catch_up(self, selected: "Selections") -> None:
        """Write the rows that stood still."""
        if self._standing:
            self._write(self._last * self._standing, selected)

    def _write(self, data: bytes, selected: "Selections") -> None:
        values = np.frombuffer(data, self._dtype).reshape(-1, *self._row)
        begin, self._rows = self._rows, self._rows + len(values)
        self._identifier.set_extent((self._rows, *self._row))
        self._identifier.write(*selected.of(begin, values.shape), values, self._kind)
        self._last, self._standing = data[-self._bytes :], 0


class Selections:
    """Where a block lies in memory and where it goes in its dataset; the same for most columns of a group."""

    def __init__(self) -> None:
        self._spaces = needed("h5py", "record").h5s
        self._made: dict[tuple[int, tuple[int, ...]], tuple[Any, Any]] = {}

    def of(self, begin: int, shape: tuple[int, ...]) -> tuple[Any, Any]:
        """For values of `shape` that go to row `begin` of a dataset that was just extended to hold them."""
        if (begin, shape) not in self._made:
            there = self._spaces.create_simple((begin + shape[0], *shape[1:]), (self._spaces.UNLIMITED, *shape[1:]))
            there.select_hyperslab((begin, *(0,) * (len(shape) - 1)), shape)
            self._made[begin, shape] = self._spaces.create_simple(shape), there
        return self._made[begin, shape]


class LiveFile:
    """`path` with one group per entry of `groups`; no other dataset or attribute can be added later. HapticdError: it exists."""

    def __init__(self, path: Path, attributes: Mapping[str, Any], groups: Mapping[str, Iterable[Channel]]) -> None:
        h5py = needed("h5py", "record")
        self.path = path
        try:
            self._file = h5py.File(path, "x", libver=("v110", "v110"))
        except OSError as error:
            raise HapticdError(f"{path}: {error}; choose another name, or `hapticd rec recover` it first") from error
        for name, value in attributes.items():
            self._file.attrs[name] = value
        counts = [Channel(ROWS, "<i8", len(groups), "")]
        self._groups = {name: self._columns(name, channels) for name, channels in {**groups, FLUSHED: counts}.items()}
        self._groups[FLUSHED][ROWS].dataset.attrs["groups"] = list(groups)
        self._rows = dict.fromkeys(groups, 0)
        self._file.swmr_mode = True
        self.descriptor: int = self._file.id.get_vfd_handle()

    def _columns(self, name: str, channels: Iterable[Channel]) -> dict[str, Column]:
        group, chunk_rows = self._file.create_group(name), CHUNK_ROWS.get(name, FEW_ROWS)
        return {channel.name: Column(group, channel, chunk_rows) for channel in channels}

    def append(self, group: str, columns: Mapping[str, NDArray[Any]]) -> None:
        """Add rows to all columns of `group`."""
        selected = Selections()
        for name, values in columns.items():
            self._groups[group][name].append(values, selected)
        self._rows[group] += len(values)

    def flush(self) -> None:
        """Hand everything to the operating system: from here on it survives the end of this process."""
        self._file.flush()
        counts = self._groups[FLUSHED][ROWS]
        counts.append(np.array([list(self._rows.values())], "<i8"), Selections())
        counts.dataset.id.flush()

    def close(self) -> None:
        """Bring all columns to the same length and close an intact file."""
        for name in self._rows:
            for column in self._groups[name].values():
                column.catch_up(Selections())
        self._file.flush()
        self._file.close()
