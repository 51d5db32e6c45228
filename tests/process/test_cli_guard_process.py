"""What the command line says of the guard: refusals and warnings with what is allowed and the hand,
and, with real processes, that a refused change moves nothing while a worker that dies comes back.
"""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.daemon import Daemon, until

from hapticd.client import Client, GuardVerdict, Receipt
from hapticd.core.errors import CommandError

# --- real processes -------------------------------------------------------------------------------


@pytest.fixture
def daemon(runtime: Path) -> Iterator[Daemon]:
    """With the rights that it gets, for without them a busy machine has delays of many periods."""
    with Daemon(runtime, settings="") as daemon:
        yield daemon


def refused(client: Client) -> GuardVerdict:
    """The verdict with which less damping is refused, once the machine lets the gateway work."""

    def once() -> CommandError | None:
        with pytest.raises(CommandError) as caught:
            client.damping("off")
        return None if caught.value.code == "timeout" else caught.value

    error = until(once, "a refusal")
    found: GuardVerdict = error.guard
    assert (error.code, found.policy) == ("guard", "refuse")
    return found


def judged(client: Client) -> GuardVerdict:
    """As `refused`, once there is a verdict."""
    return until(lambda: (found := refused(client)).safe is False and found, "a verdict")


def insisting(ask: Callable[[], Receipt]) -> Receipt:
    """What `ask` gives once there is a verdict: a worker that begins may take longer than 0.5 s."""

    def once() -> Receipt | None:
        try:
            return ask()
        except CommandError as error:
            if error.code != "timeout" and (error.guard is None or error.guard.safe is False):
                raise
            return None

    return until(once, "a verdict")


def other(client: Client, worker: int) -> int | None:
    """The worker that serves, once it is another one than `worker`."""
    found = client.guard()
    return found.pid if found.worker == "up" and found.pid != worker else None


@pytest.mark.process
def test_refused_change_names_its_hand_and_a_killed_worker_comes_back(daemon: Daemon) -> None:
    with Client(daemon.instance, folder=daemon.folder) as client:
        until(lambda: client.guard().worker == "up", "the worker")
        assert client.guard("refuse").policy == "refuse"
        # enough damping for a delay of several periods, which a busy machine has
        insisting(lambda: client.damping(10.0))
        receipt = insisting(lambda: client.set(K=500, B=2))
        assert receipt.guard is not None
        assert receipt.guard.safe is True
        insisting(client.enable)
        verdict = judged(client)
        assert verdict.basis == "theorem"
        assert verdict.radius is not None
        found = client.hand(verdict, 20.0)
        assert found is not None
        # with the delay of a busy machine it may shake by itself, without any hand
        assert verdict.radius >= 1.0 or found.hand.radius > 1.0
        worker = client.guard().pid
        os.kill(worker, signal.SIGKILL)
        assert refused(client).safe is not True  # by nobody, or by the next one already
        assert client.get().parameters["active_damping"] > 0.0
        last = until(lambda: other(client, worker), "the next worker")
        judged(client)
        client.stop()  # by the stop word, where the gateway has no processor for 40 ms
        until(lambda: client.status().state == "stopped", "the stop")
    os.kill(daemon.children()["gateway"], signal.SIGKILL)
    until(lambda: not Path(f"/proc/{last}").exists(), "the worker's end with its gateway")


@pytest.mark.process
def test_worker_that_hangs_holds_up_no_stop_and_is_replaced(daemon: Daemon) -> None:
    with Client(daemon.instance, folder=daemon.folder) as client:
        until(lambda: client.guard().worker == "up", "the worker")
        client.guard("refuse")
        worker = client.guard().pid
        os.kill(worker, signal.SIGSTOP)
        with pytest.raises(CommandError) as caught:
            client.set(K=10)
        assert caught.value.guard is not None
        assert caught.value.guard.basis == "unknown"
        assert client.stop().state == "stopped"
        until(lambda: other(client, worker), "the next worker")
        assert not Path(f"/proc/{worker}").exists()
