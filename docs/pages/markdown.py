"""Markdown tables, and their insertion into a page."""


def table(headings: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a Markdown table."""
    lines = [headings, ("---",) * len(headings), *rows]
    return (
        "\n".join(
            f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines
        )
        + "\n"
    )


def replaced(page: str, name: str, part: str) -> str:
    """Return `page` with `part` between `<!-- NAME -->` and `<!-- end of NAME -->`. ValueError
    without these marks.
    """
    before, begin, rest = page.partition(f"<!-- {name} -->\n")
    _, end, after = rest.partition(f"<!-- end of {name} -->")
    if not end:
        raise ValueError(f"the page has no place for {name!r}")
    return f"{before}{begin}\n{part.strip()}\n\n{end}{after}"
