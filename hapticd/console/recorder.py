"""Recording from the page: `hapticd record` as a separate process, one at a time.

It is that verb, so the file is the same. If the page or the console dies, the recorder ends in
order: it receives SIGTERM when the console dies, which finishes the file. Files go to the folder in
which the console was started; no text from a page becomes part of a path.

`--parent` makes the kernel send SIGTERM when this process dies in any way. A long-lived thread must
start it, for the kernel watches that thread.
"""

import asyncio
import json
import os
import signal
import sys
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

LONGEST_NOTE = 500
LIVE = ".part.h5"  # suffix of a recording in progress
LOOK_S = 0.05  # until the file exists


class Recorder:
    """The recorder of instance `instance`; passes its state as text to `publish`."""

    def __init__(self, instance: str, folder: Path, publish: Callable[[str], None]) -> None:
        self._instance = instance
        self._folder = folder
        self._publish = publish
        self._process: asyncio.subprocess.Process | None = None
        self._task: asyncio.Task[None] | None = None

    async def start(self, note: str) -> str:
        """Start with the operator's note; return the reason against it, or an empty text."""
        if self._process is not None:
            return "a recording is under way already: stop it first"
        file = self._folder / f"{datetime.now():%Y%m%d-%H%M%S}-{self._instance}.h5"
        self._process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "hapticd", "record", str(file), "--json"),
            *("--instance", self._instance, "--parent", str(os.getpid())),
            f"--note={note[:LONGEST_NOTE]}",
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            process_group=0,
        )
        self._task = asyncio.create_task(self._await_end(self._process, file))
        part = file.with_suffix(LIVE)
        while self._process is not None and not part.exists():
            await asyncio.sleep(LOOK_S)
        if self._process is not None:
            self._tell({"recording": True, "file": str(file), "note": note})
        return ""

    def stop(self) -> str:
        """Stop the recording; its file is announced when it is packed. Return the reason against
        it, or an empty text.
        """
        if self._process is None:
            return "no recording is running"
        self._process.send_signal(signal.SIGINT)
        return ""

    async def close(self) -> None:
        """Finish the current recording."""
        if self._process is not None and self._task is not None:
            self._process.send_signal(signal.SIGINT)
            await self._task

    async def _await_end(self, process: asyncio.subprocess.Process, file: Path) -> None:
        out, err = await process.communicate()
        self._process = None
        self._tell({"recording": False, "file": str(file), "text": _ending(out, err)})

    def _tell(self, content: dict[str, Any]) -> None:
        self._publish(json.dumps({"kind": "recorder", "told": content}))


def _ending(out: bytes, err: bytes) -> str:
    """Return the final output of `hapticd record --json` in one line."""
    try:
        found = json.loads(out.decode().splitlines()[-1])
    except (ValueError, IndexError):
        return f"not recorded: {err.decode(errors='replace').strip()[-300:]}"
    if not found.get("ok"):
        return f"not recorded: {found['error']['message']}"
    missing = found["missing"]["servo"]
    return f"{found['file']}: {found['seconds']:.1f} s, {found['records']} ticks, {missing} missing"
