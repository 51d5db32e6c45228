"""The modules that the processes really load. import-linter (in `make test`) checks the declared
layers; this checks the running processes.
"""

import json
import subprocess
import sys
from typing import Any

# without logging: pyusb imports it; no module of ours may import it (import-linter)
NEVER_IN_SERVO = {
    "numpy",
    "scipy",
    "numba",
    "zmq",
    "msgpack",
    "pydantic",
    "typer",
    "rich",
    "asyncio",
    "tomllib",
}


def modules_after(program: str, *arguments: str) -> Any:
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def packages(modules: list[str]) -> set[str]:
    return {name.partition(".")[0] for name in modules}
