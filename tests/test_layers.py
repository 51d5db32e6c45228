"""What the processes really load. import-linter (in `make test`) holds the declared layers;
this looks at what runs.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from hapticd.assembly import resolve
from hapticd.settings.load import load

# logging is not among them: pyusb brings it along; nothing of ours may import it (import-linter)
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
NEVER_IN_GATEWAY = {"numba", "scipy", "usb", "typer", "rich", "tomllib"}

FLY_AND_TELL = """
import json, os, signal, sys
from hapticd.assembly.servo_main import main

def look(*_):
    global threads
    threads = len(os.listdir("/proc/self/task"))
    signal.raise_signal(signal.SIGTERM)

signal.signal(signal.SIGALRM, look)
signal.setitimer(signal.ITIMER_REAL, 0.5)
code = main(sys.argv[1:])
print(json.dumps({"code": code, "threads": threads, "modules": sorted(sys.modules)}))
"""


def modules_after(program: str, *arguments: str) -> Any:
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


def packages(modules: list[str]) -> set[str]:
    return {name.partition(".")[0] for name in modules}


@pytest.mark.process
def test_flying_servo_is_small_and_single(runtime: Path) -> None:
    """The simulated board included: one thread, and none of the libraries that bring threads,
    locks or pauses.
    """
    config = runtime / "hapticd.toml"
    config.write_text("[realtime]\nmode = 'off'\nspin_us = 0.0\n")
    written = resolve.write(runtime / "hapticd" / "instance-layers", load(config), "layers")
    found = modules_after(FLY_AND_TELL, str(written["servo.json"]), str(written["board.json"]))
    assert found["code"] == 0
    assert found["threads"] == 1
    assert packages(found["modules"]) & NEVER_IN_SERVO == set()
    assert "hapticd.sim.backend" in found["modules"]
    assert not [
        name
        for name in found["modules"]
        if name.startswith(("hapticd.settings", "hapticd.gateway", "hapticd.client"))
    ]


def test_servo_of_a_real_board_loads_no_simulator() -> None:
    """Importing the process is what a servo of a real board does; a simulated one imports more."""
    modules = modules_after(
        "import json, sys, hapticd.assembly.servo_main; print(json.dumps(sorted(sys.modules)))"
    )
    assert packages(modules) & NEVER_IN_SERVO == set()
    assert not [name for name in modules if name.startswith(("hapticd.sim", "hapticd.plant"))]


def test_gateway_brings_no_compiler_and_no_board() -> None:
    modules = modules_after(
        "import json, sys, hapticd.assembly.gateway_main; print(json.dumps(sorted(sys.modules)))"
    )
    assert packages(modules) & NEVER_IN_GATEWAY == set()
    assert not [
        name
        for name in modules
        if name.startswith(
            ("hapticd.servo", "hapticd.sim", "hapticd.engine", "hapticd.settings", "hapticd.link")
        )
    ]


def test_quick_stop_loads_no_models() -> None:
    modules = modules_after(
        "import json, sys, hapticd.__main__, hapticd.client.fast_stop;"
        " print(json.dumps(sorted(sys.modules)))"
    )
    assert (
        packages(modules) & {"numpy", "pydantic", "typer", "rich", "zmq", "msgpack", "asyncio"}
        == set()
    )


def test_command_line_starts_without_models() -> None:
    modules = modules_after(
        "import json, sys, hapticd.cli.app; print(json.dumps(sorted(sys.modules)))"
    )
    assert packages(modules) & {"numpy", "pydantic", "zmq", "rich", "tomllib"} == set()
