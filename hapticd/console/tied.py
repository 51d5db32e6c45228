"""A verb that ends with who started it: `python -m hapticd.console.tied PARENT VERB ...`.

The kernel is asked to send SIGTERM when the parent is gone, however it went, and this process
becomes `hapticd VERB ...`, which keeps that wish.

What would break it: starting it from a thread that ends, for the kernel means that thread.
"""

import os
import sys

from hapticd.core.process import die_with_parent


def main(parent: str, *words: str) -> None:
    """Become the verb."""
    die_with_parent(int(parent))
    os.execv(sys.executable, [sys.executable, "-m", "hapticd", *words])


if __name__ == "__main__":
    main(*sys.argv[1:])
