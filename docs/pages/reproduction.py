"""Numbers and tables of docs/reproduction.md, from the table of a run. Marks, which are invisible
on the rendered page, define the places.

    <!-- table limits -->...<!-- /table -->            the table of a part, with its notes
    <!--= K_max_off weir2008 .0f -->105<!--/-->        a number in a Python format: quantity,
                                                       device, format
    <!--= K_max_off:sd weir2008 .1f x10 -->...<!--/--> another field of the row, and a factor

Limitations: a mark for a missing row; it is refused.
"""

import re
from collections.abc import Iterable

from examples.weir2008.page import parts, table_part
from examples.weir2008.rows import PaperRow, by_quantity
from hapticd.core.errors import ConfigError

TABLE = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- /table -->)", re.DOTALL)
NUMBER = re.compile(
    r"(<!--= (\w+)(?::(\w+))? (\w+) (\S+?)(?: x(\S+))? -->).*?(<!--/-->)", re.DOTALL
)


def filled(page: str, rows: Iterable[PaperRow]) -> str:
    """Return the page with tables and numbers of `rows`. ConfigError for a mark without its row."""
    found = tuple(rows)
    sections = parts(found)
    quantities = by_quantity(found)

    def table(mark: re.Match[str]) -> str:
        if mark[2] not in sections:
            raise ConfigError(
                f"{mark[0].splitlines()[0]}: the table has no part of that name; it has"
                f" {', '.join(sections)}"
            )
        return f"{mark[1]}\n{table_part(sections[mark[2]])}\n\n{mark[3]}"

    def number(mark: re.Match[str]) -> str:
        row = quantities.get(mark[2], {}).get(mark[4])
        if row is None:
            raise ConfigError(
                f"{mark[1]}: the table has no {mark[2]} of {mark[4]}; correct the mark, or run what"
                " makes that row"
            )
        return (
            f"{mark[1]}{getattr(row, mark[3] or 'ours') * float(mark[6] or 1.0):{mark[5]}}{mark[7]}"
        )

    return NUMBER.sub(number, TABLE.sub(table, page))
