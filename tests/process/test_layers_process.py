"""What the processes really load. import-linter (in `make test`) holds the declared layers;
this looks at what runs.
"""

from pathlib import Path

import pytest
from support.layers import NEVER_IN_SERVO, modules_after, packages

from hapticd.run import supervisor
from hapticd.settings.load import load

FLY_AND_TELL = """
import json, os, signal, sys
from hapticd.run.servo_main import main

def look(*_):
    global threads
    threads = len(os.listdir("/proc/self/task"))
    signal.raise_signal(signal.SIGTERM)

signal.signal(signal.SIGALRM, look)
signal.setitimer(signal.ITIMER_REAL, 0.5)
code = main(sys.argv[1:])
print(json.dumps({"code": code, "threads": threads, "modules": sorted(sys.modules)}))
"""


@pytest.mark.process
def test_flying_servo_is_small_and_single(runtime: Path) -> None:
    """The simulated board included: one thread, and none of the libraries that bring threads,
    locks or pauses.
    """
    config = runtime / "hapticd.toml"
    config.write_text("[realtime]\nmode = 'off'\nspin_us = 0.0\n")
    written = supervisor.write(runtime / "hapticd" / "instance-layers", load(config), "layers")
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
