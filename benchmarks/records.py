"""The record of a tick, from its one table: the index of a field in the tuple of layout.RECORD, and
the same as a C struct.
"""

from hapticd.mailbox import layout

_C_TYPES = {
    "<u8": "uint64_t",
    "<i8": "int64_t",
    "<u4": "uint32_t",
    "<i4": "int32_t",
    "<f4": "float",
    "<f8": "double",
    "u1": "uint8_t",
}
_PLAN = {name for name, *_ in layout.PLAN_FIELDS}
_PLAN_FIELD = ("plan", f"V{layout.PLAN.size}")


def _fields() -> list[tuple[str, str, int]]:
    """Return name, type and number of values of each field; those of the plan are one, as they are
    packed once per change.
    """
    rows = [row for row in layout.TELEMETRY if row[0] not in _PLAN]
    first = [row[0] for row in layout.TELEMETRY].index(layout.PLAN_FIELDS[0][0])
    rows.insert(first, _PLAN_FIELD)
    return [(name, kind, *(shape[0] if shape else (1,))) for name, kind, *shape in rows]


def place(name: str) -> int:
    """Return the index of the (first) value of field `name` in a tuple of layout.RECORD."""
    before = 0
    for field, _, count in _fields():
        if field == name:
            return before
        before += count
    raise KeyError(name)


def c_struct() -> str:
    """Return `struct record` with the table's names, packed."""
    rows = [_declaration(*field) for field in _fields()]
    return "\n".join(
        [
            "#include <stdint.h>",
            "#pragma pack(push, 1)",
            "struct record {",
            *rows,
            "};",
            "#pragma pack(pop)",
            "",
        ]
    )


def _declaration(name: str, kind: str, count: int) -> str:
    if kind[0] == "V":
        return f"    uint8_t {name}[{kind[1:]}];"
    return f"    {_C_TYPES[kind]} {name}{f'[{count}]' if count > 1 else ''};"
