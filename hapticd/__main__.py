"""`hapticd` and `python -m hapticd`.

`hapticd stop` has a way of its own: it acts before the command line with all its libraries is
loaded.
"""

import sys
from typing import NamedTuple


def main() -> int:
    """Run the command line; the exit code."""
    arguments = sys.argv[1:]
    if arguments[:1] == ["stop"] and (found := _plain_stop(arguments[1:])) is not None:
        from hapticd.client.fast_stop import main as fast_stop

        return fast_stop(found.instance, "--json" in arguments)
    from hapticd.cli.app import main as command_line

    return command_line(arguments)


class PlainStop(NamedTuple):
    """A stop that needs nothing of the full command line."""

    instance: str | None  # None: every daemon there is


def _plain_stop(arguments: list[str]) -> PlainStop | None:
    """Whom to stop; None when the arguments need the full command line (help, mistakes)."""
    rest = [argument for argument in arguments if argument != "--json"]
    if not rest:
        return PlainStop(None)
    if len(rest) == 2 and rest[0] == "--instance":
        return PlainStop(rest[1])
    if len(rest) == 1 and rest[0].startswith("--instance="):
        return PlainStop(rest[0].removeprefix("--instance="))
    return None


if __name__ == "__main__":
    sys.exit(main())
