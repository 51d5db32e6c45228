"""The wire is the standard library alone: it can be carried to any host, and the servo stays
small.
"""

import json
import subprocess
import sys

PROGRAM = """
import json, sys
before = set(sys.modules)
import hapticd.usb.codec, hapticd.usb.frames, hapticd.usb.codec
print(json.dumps(sorted(set(sys.modules) - before)))
"""


def loaded() -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout))


def test_wire_loads_standard_library_only() -> None:
    modules = loaded()
    assert {
        "hapticd.usb.frames",
        "hapticd.usb.codec",
    } <= modules
    ours = {name for name in modules if name.partition(".")[0] == "hapticd"}
    assert {name.partition(".")[0] for name in modules - ours} <= sys.stdlib_module_names
    assert {name for name in ours if not name.startswith("hapticd.usb")} <= {
        "hapticd",
        "hapticd.core",
        "hapticd.core.errors",
        "hapticd.core.lazy",
    }


def test_wire_loads_no_input_output() -> None:
    assert not loaded() & {"logging", "asyncio", "socket", "mmap", "threading", "subprocess"}
