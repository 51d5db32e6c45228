"""`hapticd stop` reaches what moves: every live daemon of this user and the service, past
leftovers, strangers and whatever hangs; and it says whom it has stopped.
"""

import subprocess
import sys
from pathlib import Path

import pytest
from support.fast_stop import servo

from hapticd.mailbox import files


@pytest.mark.process
def test_whole_stop_loads_nothing_large(runtime: Path) -> None:
    script = (
        "import sys; from hapticd.__main__ import main; sys.argv[1:] = ['stop']; main();"
        " print(*sys.modules)"
    )
    with servo(files.runtime_folder()) as moving:
        found = subprocess.run(
            [sys.executable, "-c", script], capture_output=True, text=True, check=True
        )
        assert moving.stop_word.pressed
    loaded = {name.partition(".")[0] for name in found.stdout.split()}
    assert not {"zmq", "numpy", "msgpack", "pydantic", "typer", "rich", "asyncio"} & loaded
