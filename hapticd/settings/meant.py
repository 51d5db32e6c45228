"""What a misspelt name was probably meant to be."""

import difflib
from collections.abc import Sequence


def did_you_mean(word: str, known: Sequence[str]) -> str:
    """`; did you mean 'x'?` or nothing."""
    lower = {name.lower(): name for name in known}
    close = difflib.get_close_matches(word.lower(), lower, 1, 0.6)
    return f"; did you mean {lower[close[0]]!r}?" if close else ""
