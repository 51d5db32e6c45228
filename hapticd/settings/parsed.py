"""A file as its table, also where something in it is wrong: then what is left without it.

Rules between keys need a table. So that they are looked at beside a misspelt key or a wrong number,
what is wrong is taken out and stands as its default meanwhile; a rule counts only if nothing of
that is near what it looks at (`concerns`).

What would break it: a rule whose limit comes from another table that it does not name.
"""

import copy
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pydantic import ValidationError

from hapticd.settings.tables import TomlTable, Where, config_error
from hapticd.settings.toml import KeyPath

T = TypeVar("T", bound=TomlTable)


@dataclass(frozen=True)
class Parsed(Generic[T]):
    """`table` without what is `wrong`; None where nothing sensible is left."""

    table: T | None
    errors: str  # a line for each mistake; empty: there is none
    wrong: tuple[KeyPath, ...] = ()

    @property
    def sound(self) -> T:
        """The table of a file in which nothing is wrong."""
        assert self.table is not None
        assert not self.errors
        return self.table


def parsed(model: type[T], data: dict[str, Any], where: Where) -> Parsed[T]:
    """`data` as `model`. `where` tells file and line of a key."""
    try:
        return Parsed(model.model_validate(data), "")
    except ValidationError as error:
        wrong = tuple(detail["loc"] for detail in error.errors())
        return Parsed(_rest(model, data, wrong), str(config_error(error, model, where)), wrong)


def _rest(model: type[T], data: dict[str, Any], wrong: Iterable[KeyPath]) -> T | None:
    """`data` without what is `wrong`, as a table if it is one then."""
    left = copy.deepcopy(data)
    for path in wrong:
        _take_out(left, path)
    try:
        return model.model_validate(left)
    except ValidationError:
        return None


def _take_out(data: dict[str, Any], path: KeyPath) -> None:
    """Remove what stands at `path`, or the whole list in which it stands."""
    table: Any = data
    for step, below in zip(path, (*path[1:], ""), strict=True):
        if not isinstance(table, dict):
            return
        if step == path[-1] or isinstance(below, int):
            table.pop(step, None)
            return
        table = table.get(step)


def concerns(paths: Iterable[KeyPath], wrong: Iterable[KeyPath]) -> bool:
    """Whether any of `wrong` stands at one of `paths`, above it, or in the same table beside it."""
    tables = [path[:-1] or path for path in paths]
    return any(
        mistake[: len(table)] == table or table[: len(mistake)] == mistake
        for table in tables
        for mistake in wrong
    )
