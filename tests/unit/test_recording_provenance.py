"""Where numbers come from is complete, also without git and without extras."""

import json
from pathlib import Path

from support.gateway_stand_in import setup

from hapticd.protocol.answers import Hello, LeaseHeld, Status
from hapticd.recording import provenance
from hapticd.recording.file import open_recording


def test_provenance_is_complete(recording_file: Path) -> None:
    with open_recording(recording_file) as recording:
        found = recording.attributes
    assert found["schema"] == "hapticd-recording/1"
    assert (found["simulated"], found["notice"][:9]) == (1, "SIMULATED")
    assert (found["note"], found["device_serial"], found["rate_hz"]) == (
        "a note",
        "SIM0001",
        1000.0,
    )
    assert json.loads(found["realtime"]) == {"fifo": {"granted": True, "text": ""}}
    assert json.loads(found["configuration"])["device"]["serial"] == "SIM0001"
    assert set(json.loads(found["calibration"])) >= {"position", "force", "active_damping"}
    assert len(found["device_hash"]) == 64
    assert found["winding_c"] == 25.0
    assert found["kernel"].startswith("Linux ")
    assert found["utc_ns"] - found["mono_ns"] > 0
    assert set(json.loads(found["libraries"])) == {"numpy", "h5py", "pyzmq", "msgpack"}
    assert {
        "uuid",
        "started_utc",
        "hapticd_version",
        "hapticd_commit",
        "server_version",
        "python",
        "cpu",
        "config_hash",
    } <= set(found)


def test_holders_of_leases_are_named() -> None:
    held = LeaseHeld("trial", 17, left_s=3.0, ttl_s=5.0, at_end="hold")
    hello = Hello(1000.0, True, setup().servo, instance="i", version="v")
    status = Status(state="enabled", leases={"perturbation": held})
    header = {"mono_unix_offset_ns": 0, "simulated": True, "layout": "l"}
    found = provenance.of_recording(hello, status, header, "")
    assert json.loads(found["leases"]) == {"perturbation": "trial (actor 17)"}


def test_commit_of_nowhere_is_empty(tmp_path: Path) -> None:
    assert provenance.commit(tmp_path) == ""
    assert provenance.processor()
