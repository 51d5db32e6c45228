"""The device of a running daemon under a trial: its identification, and the announcement.

Every motion is announced before: the name of the device, whether it is real, and the environment in
which it is enabled. Every exit of the process must leave the device disabled.
"""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

from hapticd.cli import change, terminal
from hapticd.cli.deferred import deferred_imports
from hapticd.cli.zwidth import common
from hapticd.core.units import US_PER_S

with deferred_imports():
    from hapticd.client import client as clients
    from hapticd.model import scene as model_scene
    from hapticd.zwidth import sources, watch


@dataclass(frozen=True)
class Rig:
    """A daemon, and known facts of its device."""

    client: "clients.Client"
    instance: str  # name of the daemon
    device: str  # name in its device file
    simulated: bool  # its board is simulated
    skew_s: float  # delay of the probe's velocity behind its force, from its device file
    model: "model_scene.Scene | None"  # of the simulated device of that name, if there is one

    @property
    def origin(self) -> str:
        """Origin of its records."""
        return f"daemon {self.instance!r}, device {self.device!r}"


def open_rig(instance: str, stack: ExitStack) -> Rig:
    """Connect for as long as `stack` is open; DaemonDown without an answer.

    A signal that ends this process also ends the trial with force off.
    """
    stack.enter_context(signals_end_with_force_off())
    client = stack.enter_context(change.connect(instance))
    servo = client.hello().servo
    name = servo.device.name
    model = sources.scene_of_device(name)
    if model is not None:
        filtered = replace(
            model.environment,
            velocity_filter=servo.environment.velocity_filter,
            acceleration_filter=servo.environment.acceleration_filter,
        )
        model = replace(model, environment=filtered)
    skew_s = servo.device.probe_skew_us / US_PER_S
    return Rig(client, instance, name, servo.simulated, skew_s, model)


def announce(
    rig: Rig, trial: "sources.Trial", scene: "model_scene.Scene | None", skew_s: float
) -> None:
    """Print the coming action on stderr. `scene` is the one of the option, `skew_s` the correction
    applied.
    """
    kind = "simulated" if rig.simulated else "real, it moves"
    terminal.talk(
        f"enables the device {rig.device!r} of daemon {rig.instance!r} ({kind}) in"
        f" {common.environment_words(trial)}, and perturbs it; Ctrl-C ends the trial and"
        " switches the force off"
    )
    if rig.skew_s:
        terminal.talk(
            f"by the device file, the probe's velocity lags its force by"
            f" {US_PER_S * rig.skew_s:.3g} us; {US_PER_S * skew_s:.3g} us are corrected"
        )
    if trial.environment[0] == 0.0:
        terminal.talk(
            "with K = 0 no force keeps the device within its travel; use -K"
            f" {watch.CENTRING_N_PER_M:g}"
        )
    if rig.model is None:
        terminal.talk(f"there is no model of the device {rig.device!r}, so no prediction")
    if scene is not None and (rig.model is None or scene.device != rig.model.device):
        terminal.talk(
            f"scene {scene.name!r} is of the device {scene.device!r}, not of the daemon's: the"
            f" scene's environment is rendered on {rig.device!r}"
        )


@contextmanager
def signals_end_with_force_off() -> Iterator[None]:
    """Treat SIGTERM and SIGHUP like Ctrl-C: force off.

    The exit code is 128 + the signal's number. A signal with another handler is left alone.
    """

    def leave(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    ending = (signal.SIGTERM, signal.SIGHUP)
    unhandled = [number for number in ending if signal.getsignal(number) == signal.SIG_DFL]
    for number in unhandled:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in unhandled:
            signal.signal(number, signal.SIG_DFL)
