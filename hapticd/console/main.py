"""The console process as `hapticd run` starts it: `python -m hapticd.console.main INSTANCE`.

`--parent PID` names the supervisor that it ends with; a byte written to the descriptor of `--ready
FD` says that it serves. Exit code 0: asked to end; otherwise that of the error, which is printed in
one line on stderr.

Limitations: importing the command line, which this process does not need.
"""

import argparse
import os
import sys

from hapticd.core.errors import HapticdError
from hapticd.core.process import die_with_parent, on_stop


def main(arguments: list[str]) -> int:
    """Run a console; the exit code."""
    parser = argparse.ArgumentParser(prog="console", allow_abbrev=False)
    parser.add_argument("instance")
    parser.add_argument("--parent", type=int)
    parser.add_argument("--ready", type=int)
    asked = parser.parse_args(arguments)
    die_with_parent(asked.parent)
    from hapticd.console.server import serve

    def tell(url: str) -> None:
        if asked.ready is not None:
            os.write(asked.ready, b"1")

    try:
        serve(asked.instance, None, on_stop, tell)
    except HapticdError as error:
        sys.stderr.write(f"hapticd console: {error}\n")
        return error.exit_code
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
