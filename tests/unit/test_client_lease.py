"""A kept lease: which errors of a renewal end it, and which are tried again."""

import pytest

from hapticd.client.client import renews_again
from hapticd.core.errors import CommandError, DaemonDown, HapticdError


@pytest.mark.parametrize(
    "error",
    [DaemonDown("no answer"), CommandError("timeout", "late"), CommandError("busy", "full")],
)
def test_a_renewal_without_an_answer_is_tried_again(error: HapticdError) -> None:
    assert renews_again(error)


@pytest.mark.parametrize("code", ["leased", "refused", "invalid"])
def test_a_lease_that_is_lost_is_not_renewed(code: str) -> None:
    assert not renews_again(CommandError(code, "lost"))
