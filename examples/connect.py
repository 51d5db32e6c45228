"""Shared by the examples: the connection to a daemon, or to the virtual board with its hand."""

import argparse

import hapticd


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
