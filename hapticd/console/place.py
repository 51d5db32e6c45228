"""Where the page is, told to others by a file in the daemon's folder (`mailbox.daemons` reads it).

The file of a console that was killed stays, so that the next one of this daemon listens at the same
port and open pages find it again. A folder that is not ours to write (the service's) gets none.
"""

import json
import os
from contextlib import suppress
from pathlib import Path

from hapticd.mailbox import files
from hapticd.mailbox.daemons import require_trusted


class Place:
    """The note in `folder`. `port` is that of the console before; None: there was none."""

    def __init__(self, folder: Path) -> None:
        require_trusted(folder)
        self._path = folder / files.CONSOLE
        self.port = self._before()

    def _before(self) -> int | None:
        try:
            port = json.loads(self._path.read_text())["port"]
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return port if isinstance(port, int) and 0 < port < 1 << 16 else None

    def note(self, url: str, port: int) -> None:
        """Say where this process serves."""
        content = json.dumps({"url": url, "port": port, "pid": os.getpid()})
        fresh = self._path.with_suffix(".new")
        with suppress(OSError):
            fresh.write_text(content)
            fresh.replace(self._path)

    def forget(self) -> None:
        """Remove the note."""
        with suppress(OSError):
            self._path.unlink()
