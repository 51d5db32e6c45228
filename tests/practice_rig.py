"""A rig for practising the first day: a simulated board with hidden parameters, and its operator.

    python tests/practice_rig.py FOLDER rig [VERB ..]       `hapticd rig` in virtual time, or zwidth
    python tests/practice_rig.py FOLDER [--instance NAME]   a daemon, until Ctrl-C
    python tests/practice_rig.py FOLDER hang 0.05           one action of the operator, by hand

The first start creates FOLDER with hapticd.toml and a copy of the template of device files. Signs,
gains, friction and delay of the rig are drawn from a number that is not disclosed; they stay in the
servo's process. A client sees what a real board would show. The daemon restarts by itself when the
device file has changed.

The first form needs no daemon: servo, board and operator run as fast as they can, as in the tests.
Each verb reads the current device file. With a daemon, the operator does what `hapticd rig` asks,
as a program at a socket (HAPTICD_HAND), or what the third form requests. The rigs are those that
the tests of the steps use, with other parameters.

Limitations: a computer that cannot run a servo in time under other load loses slots (`hapticd
status` shows them), and the measured intervals get wider.
"""

import json
import os
import random
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib import import_module
from pathlib import Path
from pkgutil import walk_packages
from typing import get_args
from unittest.mock import patch

import tomlkit
from support.blind_hand import Person
from support.blind_rig import EDITS, TEMPLATE, BlindRig
from support.blind_truth import NOMINAL, BlindBoard, drawn

import hapticd.cli
from hapticd.cli.app import main as hapticd_main
from hapticd.client import Client
from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.params import ServoParams, read_params
from hapticd.core.process import die_with_parent, on_stop
from hapticd.core.units import MonotonicClock
from hapticd.mailbox.files import runtime_folder
from hapticd.model.params import BoardParams
from hapticd.rig.result import Action, Request, asked_at
from hapticd.run import servo_main
from hapticd.run.supervisor import Supervisor, spawn
from hapticd.settings.load import load

CONFIG = """\
device = "practice"
[safety]
lost_slots_limit = 10000        # a computer that practises beside other work loses slots
"""
SEED = ".rig"
HAND = "hand.sock"


def lay_out(folder: Path) -> None:
    """Files as the owner of a new board has them, if there are none."""
    device = folder / "devices" / "practice.toml"
    if device.exists():
        return
    device.parent.mkdir(parents=True, exist_ok=True)
    document = tomlkit.parse(TEMPLATE.read_text(encoding="utf-8"))
    for table, values in EDITS.items():
        (document[table] if table else document).update(values)
    device.write_text(tomlkit.dumps(document), encoding="utf-8")
    (folder / "hapticd.toml").write_text(CONFIG, encoding="utf-8")
    (folder / SEED).write_text(str(random.SystemRandom().getrandbits(32)))


def daemon(folder: Path, instance: str) -> None:
    """Serve until a signal; begin again when the device file has changed."""
    lay_out(folder)
    device = folder / "devices" / "practice.toml"
    ended = threading.Event()
    which = "" if instance == "default" else f"--instance {instance}"
    print(HELP.format(folder=folder, which=which), flush=True)
    while not ended.is_set():
        _serve(folder, device, instance, ended)


def _serve(folder: Path, device: Path, instance: str, ended: threading.Event) -> None:
    supervisor = Supervisor(
        runtime_folder(instance),
        load(folder / "hapticd.toml"),
        instance,
        MonotonicClock(),
        lambda event: print(f"practice: {event.text}", flush=True),
        start=lambda command, ready: spawn(_practised(command, folder), ready),
    )

    def end() -> None:
        ended.set()
        supervisor.stop()

    on_stop(end)
    threading.Thread(target=_watch, args=(device, supervisor), daemon=True).start()
    supervisor.run()


HELP = """
A practice rig in {folder}. In another terminal:

  export HAPTICD_CONFIG={folder}/hapticd.toml
  export HAPTICD_HAND={folder}/hand.sock      the hand does what is asked
  hapticd rig {which}
"""


def _practised(command, folder: Path) -> list[str]:
    """The servo's process is this file, with the rig in it."""
    if command[0] != "hapticd.run.servo_main":
        return list(command)
    own = str(Path(__file__).resolve().parent)
    os.environ["PYTHONPATH"] = os.pathsep.join(
        filter(None, (own, os.environ.get("PYTHONPATH", "").removeprefix(own + os.pathsep)))
    )
    return ["practice_rig", "--servo", str(folder), *command[1:]]


def _watch(device: Path, supervisor: Supervisor) -> None:
    before = device.stat().st_mtime_ns
    while device.stat().st_mtime_ns == before:
        time.sleep(0.2)
    time.sleep(0.5)
    supervisor.stop()


def quick(folder: Path, arguments: list[str]) -> int:
    """`hapticd` with `arguments` on the rig of `folder`, in virtual time; its exit code."""
    lay_out(folder)
    with ExitStack() as stack, BlindRig(int((folder / SEED).read_text())) as rig:
        rig.config_file = folder / "hapticd.toml"
        rig.device_file = folder / "devices" / "practice.toml"
        read_ns = 0

        @contextmanager
        def connected(_instance: str) -> Iterator[Client]:
            nonlocal read_ns
            if read_ns != (read_ns := rig.device_file.stat().st_mtime_ns):
                rig.restart()  # as its owner would start the daemon again
            yield rig.bench

        def ask(request: Request) -> None:
            print(f"> {request.text}")
            rig.ask(request)

        found = walk_packages(hapticd.cli.__path__, "hapticd.cli.")
        modules = [import_module(one.name) for one in found]
        for module in modules:
            if hasattr(module, "connect"):
                stack.enter_context(patch.object(module, "connect", connected))
            if hasattr(module, "asking"):
                stack.enter_context(patch.object(module, "asking", lambda yes: ask))
        named = {"HAPTICD_CONFIG": str(folder / "hapticd.toml")}
        stack.enter_context(patch.dict(os.environ, named))
        return hapticd_main(arguments)


def servo(folder: Path, arguments: list[str]) -> None:
    """The servo's process."""
    die_with_parent(int(arguments[arguments.index("--parent") + 1]))
    sys.setswitchinterval(1e-4)  # short, so that the hand's thread soon yields to the tick
    truth = drawn(int((folder / SEED).read_text()))
    person = Person(truth.seed, truth.mass_kg, time.sleep, lambda kg: board.attach(kg))
    person.mass_error = truth.mass_error
    person.distance_error_m = truth.distance_error_m
    board = BlindBoard(truth, None, person.pull_n)
    threading.Thread(target=serve_hand, args=(folder / HAND, person), daemon=True).start()
    params = read_params(ServoParams, Path(arguments[0]))
    with patch.object(servo_main, "simulated_backend", board.backend):
        found = servo_main.Servo(params, BoardParams(**NOMINAL), MonotonicClock())
    on_stop(found.stop)
    found.run()


def serve_hand(path: Path, person: Person) -> None:
    """Serve the requests at the socket `path`, one after the other."""
    path.unlink(missing_ok=True)
    with socket.socket(socket.AF_UNIX) as door:
        door.bind(str(path))
        door.listen()
        while True:
            line, _ = door.accept()
            with line:
                asked = json.loads(line.makefile("rb").readline())
                try:
                    person.ask(Request(asked["action"], asked["text"], asked["amount"]))
                    answer = {"done": True}
                except (KeyError, ValueError, TypeError) as error:
                    answer = {"error": str(error)}
                line.sendall(json.dumps(answer).encode() + b"\n")


def main(arguments: list[str]) -> int:
    """Run one of the forms above."""
    if arguments[0] == "--servo":
        servo(Path(arguments[1]), arguments[2:])
        return 0
    folder = Path(arguments[0]).resolve()
    if arguments[1:2] in (["rig"], ["zwidth"]):
        return quick(folder, arguments[1:])
    if arguments[1:2] and arguments[1] not in (*get_args(Action), "--instance"):
        raise ConfigError(
            f"{arguments[1]!r} needs a daemon: start `make practice`, then run `hapticd"
            f" {arguments[1]}` in another terminal"
        )
    if len(arguments) > 1 and arguments[1] != "--instance":
        amount = float(arguments[2]) if len(arguments) > 2 else 0.0
        asked_at(folder / HAND)(Request(arguments[1], "by hand", amount))
        return 0
    daemon(folder, arguments[2] if len(arguments) > 2 else "default")
    return 0


if __name__ == "__main__":
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    try:
        raise SystemExit(main(sys.argv[1:]))
    except HapticdError as error:
        raise SystemExit(f"practice: {error}") from None
