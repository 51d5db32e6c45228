"""Every public method of both clients has an example of at most three statements, and each example
is run on virtual time and gives what it says.
"""

import ast
import asyncio
import doctest
import inspect
import io
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.gateway_rig import GatewayRig, running

import hapticd
from hapticd.client import AsyncClient, Client, step
from hapticd.run.virtual import VirtualBoard

pytestmark = pytest.mark.filterwarnings("ignore::hapticd.core.errors.GuardWarning")

MOST_LINES = 3
LOOSE = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
NEEDS_GATEWAY = {"dump"}  # it writes a file, which virtual time does not keep


def public(client: type) -> list[str]:
    found = inspect.getmembers(client, callable)
    return [name for name, _ in found if not name.startswith("_")]


OWN = [name for name in public(AsyncClient) if name in vars(AsyncClient)]  # the rest is shared


def examples(client: type, name: str) -> list[doctest.Example]:
    text = inspect.getdoc(getattr(client, name)) or ""
    return doctest.DocTestParser().get_examples(text)


@pytest.fixture(scope="module")
def shared() -> Iterator[VirtualBoard]:
    with hapticd.virtual_board() as board:
        yield board


@pytest.fixture
def board(shared: VirtualBoard) -> Iterator[VirtualBoard]:
    """As the examples find it: disabled, the active damping on."""
    shared.guard("warn", margin_ns_per_m=0.0)
    shared.damping("on")
    shared.set(K=0, B=0, M=0)
    shared.sleep(0.5)
    yield shared
    shared.perturb_stop()
    if shared.status().state == "stopped":
        shared.sleep(1.1)
        shared.reset()
    shared.disable()


async def run(found: list[doctest.Example], device: Any) -> None:
    names = {"__name__": "example", "device": device, "np": np, "step": step}
    for one in found:
        got = await output(one.source, names)
        want = one.want.splitlines()[-1] + "\n" if one.exc_msg else one.want
        assert doctest.OutputChecker().check_output(want, got, LOOSE), f"{one.source}{got}"


async def output(source: str, names: dict[str, Any]) -> str:
    """What a statement, which may await, prints; of an error its name and text."""
    code = compile(source, "example", "single", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
    printed = io.StringIO()
    with redirect_stdout(printed):
        try:
            result = eval(code, names)
            if inspect.iscoroutine(result):
                await result
        except hapticd.core.errors.HapticdError as error:
            return f"{type(error).__name__}: {error}\n"
    return printed.getvalue()


@pytest.mark.parametrize("name", sorted({*public(Client)} - NEEDS_GATEWAY - {"close"}))
def test_example_of_the_client_gives_what_it_says(name: str, board: VirtualBoard) -> None:
    asyncio.run(run(examples(Client, name), board))


@pytest.mark.parametrize("name", sorted({*OWN} - {"close"}))
def test_example_for_asyncio_gives_what_it_says(name: str, board: VirtualBoard) -> None:
    asyncio.run(run(examples(AsyncClient, name), board.aio()))


def test_example_of_a_dump_gives_what_it_says(runtime: Path) -> None:
    folder = runtime / "hapticd"
    with GatewayRig(folder) as rig:
        rig.step(100)  # something has been recorded before it is asked for
        with running(rig), Client(folder=folder) as device:
            asyncio.run(run(examples(Client, "dump"), device))


def test_examples_of_closing_run() -> None:
    with hapticd.virtual_board() as board:
        asyncio.run(run(examples(Client, "close"), board))
    asyncio.run(run(examples(AsyncClient, "close"), hapticd.virtual_board().aio()))


@pytest.mark.parametrize(
    ("client", "name"),
    [(Client, one) for one in public(Client)] + [(AsyncClient, one) for one in OWN],
)
def test_every_public_method_has_a_short_example(client: type, name: str) -> None:
    found = examples(client, name)
    assert 1 <= sum(len(one.source.splitlines()) for one in found) <= MOST_LINES
