"""Which columns a stream of records becomes, and in which units (UDUNITS)."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapticd.gateway.encode import ENERGIES
from hapticd.units import unit_of

Columns = dict[str, NDArray[Any]]
LEFT_OUT = "tail"  # repeats the tick, for readers of the ring
_SIGNED = {"<u8": "<i8"}  # 64-bit unsigned integers are no joy in MATLAB


class Channel(NamedTuple):
    """A dataset: its name, number type, bytes per row (0: one number per row) and unit."""

    name: str
    kind: str
    width: int
    unit: str


def channels(descr: Sequence[Sequence[Any]]) -> list[Channel]:
    """The channels of records with numpy `descr`."""
    found = []
    for name, kind, *shape in (field for field in descr if field[0] != LEFT_OUT):
        if shape:
            found += [Channel(part, kind, 0, udunits(part)) for part in _parts(name, shape[0][0])]
        elif kind.startswith("V"):
            found.append(Channel(name, "u1", int(kind[1:]), ""))
        else:
            found.append(Channel(name, _SIGNED.get(kind, kind), 0, udunits(name)))
    return found


def columns(records: NDArray[np.void]) -> Columns:
    """The columns of a block of records, in the order of `channels`: views, of the bytes that the channels' types mean."""
    found: Columns = {}
    for name in (name for name in records.dtype.names or () if name != LEFT_OUT):
        column = records[name]
        if column.ndim == 2:
            found |= {part: column[:, place] for place, part in enumerate(_parts(name, column.shape[1]))}
        else:
            found[name] = column
    return found


def as_channel(channel: Channel, values: NDArray[Any]) -> NDArray[Any]:
    """`values` of a column as numbers of its channel: (n,), bytes (n, width)."""
    row = (channel.width,) if channel.width else ()
    return np.frombuffer(values.tobytes(), channel.kind).reshape(-1, *row)


def _parts(name: str, count: int) -> tuple[str, ...]:
    return ENERGIES if name == "energy_j" else tuple(f"{name}_{place}" for place in range(count))


def udunits(name: str) -> str:
    """Unit of a field as UDUNITS writes it: N s/m -> N s m-1."""
    over, _, under = unit_of(name).partition("/")
    powers = [f"{base}-{power or 1}" for base, _, power in (part.partition("^") for part in under.split())]
    return " ".join([over, *powers]).strip()
