"""Which leases a thread may keep alive."""

from typing import Any

import pytest

from hapticd.client.lease import ClientLease
from hapticd.core.errors import CommandError


def unasked(*_: Any, **__: Any) -> dict[str, Any]:
    raise AssertionError("nothing is to be asked")


@pytest.mark.parametrize("what", ["perturbation", "measuring"])
def test_what_moves_the_handle_by_itself_is_not_kept_alive(what: str) -> None:
    with pytest.raises(CommandError, match="environment and active_damping") as refused:
        ClientLease(unasked, what, keep_alive=True)
    assert refused.value.code == "invalid"
