"""Results as objects that JSON can carry: arrays become lists, complex numbers pairs, what is not finite null."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from math import isfinite
from typing import Any

import numpy as np


def plain(value: Any, *, skip: tuple[str, ...] = ()) -> Any:
    """`value` as dicts, lists, strings and finite numbers; fields named in `skip` are left out."""
    if is_dataclass(value) and not isinstance(value, type):
        return {item.name: plain(getattr(value, item.name), skip=skip) for item in fields(value) if item.name not in skip}
    if isinstance(value, Mapping):
        return {str(key): plain(each, skip=skip) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [plain(each, skip=skip) for each in value]
    if isinstance(value, np.ndarray):
        whole = value.dtype.kind in "fiub" and bool(np.isfinite(value).all())  # the usual case, at a hundredth of the time
        return value.tolist() if whole else plain(value.tolist(), skip=skip)
    if isinstance(value, np.generic):
        return plain(value.item(), skip=skip)
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float):
        return value if isfinite(value) else None
    return value if isinstance(value, str | int | bool | None) else str(value)
