"""Every check of the doctor in every branch, on machines made of a few files."""

import pytest

from hapticd.run.doctor import late


def test_worker_that_fails_says_why() -> None:
    with pytest.raises(OSError, match="ValueError: invalid literal"):
        late.measure(0.0, "x")  # type: ignore[arg-type]
