"""Shared by the examples: the connection to a daemon, or to the virtual board with its hand; and
the guard's answer about a setting.
"""

import argparse
from collections.abc import Callable
from typing import Any

import hapticd
from hapticd.client import Client, CommandError, Receipt

ATTEMPTS = 100


def arguments(description: str) -> argparse.ArgumentParser:
    """Return the parser with the options of every example."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--instance", default="default", metavar="NAME", help="of the daemon")
    parser.add_argument(
        "--virtual",
        action="store_true",
        help="no daemon: a simulated board on virtual time, whose handle a simulated hand moves",
    )
    return parser


def connected(asked: argparse.Namespace, name: str, strict: bool = False) -> hapticd.Client:
    """Return the requested client."""
    if asked.virtual:
        return hapticd.virtual_board(hand=True, strict=strict, name=name)
    return hapticd.Client(asked.instance, name=name, strict=strict)


def connected_aio(asked: argparse.Namespace, name: str) -> hapticd.AsyncClient:
    """Return the requested client for asyncio."""
    if asked.virtual:
        return hapticd.virtual_board(hand=True, name=name).aio()
    return hapticd.AsyncClient(asked.instance, name=name)


def judged(change: Callable[[], Receipt]) -> Receipt:
    """Make a change, and repeat it while the guard has no verdict in time on a busy computer."""
    for _ in range(ATTEMPTS):
        try:
            return change()
        except CommandError as error:
            if error.guard is None or error.guard.safe is not None:
                raise  # a refusal for another reason, or an unsafe change
    raise RuntimeError("the guard gave no verdict: the computer is too busy")


def permitted(device: Client, **settings: Any) -> bool:
    """Set these values if the guard permits them; return whether it did."""
    try:
        judged(lambda: device.set(**settings))
    except CommandError as error:
        if error.guard is None:
            raise
        return False
    return True
