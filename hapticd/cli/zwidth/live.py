"""The device of a running daemon under a trial: which one it is, what is known of it, and what is said before it moves."""

import signal
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hapticd.cli import output

if TYPE_CHECKING:
    from hapticd.client import Client
    from hapticd.measure.sources import Trial
    from hapticd.plant.scene import Scene


@dataclass(frozen=True)
class Rig:
    """A daemon's device by the name in its device file; `model`: the scene of the device of that name, if one is known."""

    client: "Client"
    instance: str
    device: str
    simulated: bool
    model: "Scene | None"

    @property
    def origin(self) -> str:
        """Of its records."""
        return f"daemon {self.instance!r}, device {self.device!r}"


def rig(instance: str, stack: ExitStack) -> Rig:
    """Connect for as long as `stack`; what ends this process meanwhile ends the trial with force off. DaemonDown."""
    from hapticd.cli.change import connect
    from hapticd.measure.scenes import scene_of_device
    from hapticd.params import EnvironmentParams, from_plain

    stack.enter_context(_ends_are_heard())
    client = stack.enter_context(connect(instance))
    servo = client.hello()["servo"]
    name, model = servo["device"]["name"], scene_of_device(servo["device"]["name"])
    if model is not None:
        own = from_plain(EnvironmentParams, servo["environment"])
        filtered = replace(model.environment, velocity_filter=own.velocity_filter, acceleration_filter=own.acceleration_filter)
        model = replace(model, environment=filtered)
    return Rig(client, instance, name, servo["simulated"], model)


def announce(rig: Rig, trial: "Trial", scene: "Scene | None") -> None:
    """What is about to happen, on stderr, before it does. `scene` is the one that was named."""
    from hapticd.measure.watch import CENTRING_N_PER_M

    k, b, m = trial.environment
    kind = "simulated" if rig.simulated else "real, it moves"
    output.talk(
        f"enables the device {rig.device!r} of daemon {rig.instance!r} ({kind}) in K {k:g} N/m, B {b:g} N s/m, M {m:g} kg, "
        f"added damping {trial.damping_ns_per_m:g} N s/m, and shakes it; Ctrl-C ends it, force off"
    )
    if k == 0.0:
        output.talk(f"with K = 0 nothing holds the device in its travel; -K {CENTRING_N_PER_M:g} would")
    if rig.model is None:
        output.talk(f"no model of a device {rig.device!r} is known, so nothing is predicted")
    if scene is not None and (rig.model is None or scene.device != rig.model.device):
        output.talk(
            f"scene {scene.name!r} is of the device {scene.device!r}, the daemon has {rig.device!r}: what the scene says is "
            "rendered on that"
        )


@contextmanager
def _ends_are_heard() -> Iterator[None]:
    """Whoever ends this process, or closes its terminal, gets what Ctrl-C gets: force off. Exit 128 + the signal's number."""

    def leave(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    heard = [number for number in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(number) == signal.SIG_DFL]
    for number in heard:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in heard:
            signal.signal(number, signal.SIG_DFL)
