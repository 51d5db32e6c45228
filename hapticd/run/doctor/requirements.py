"""What the configuration asks of the machine, as far as the doctor cares."""

from dataclasses import dataclass
from pathlib import Path

from hapticd.core.params import RealtimeParams, UsbParams
from hapticd.mailbox.daemons import untrusted_daemon_folder
from hapticd.mailbox.files import DEFAULT_INSTANCE
from hapticd.settings.build import gateway_params, servo_params
from hapticd.settings.load import Settings

__all__ = ["Requirements", "requirements"]


@dataclass(frozen=True)
class Requirements:
    """What a daemon needs of its machine."""

    realtime: RealtimeParams  # rate, priority, core and spin of the servo
    usb: UsbParams  # which board
    simulated: bool  # the configured board is simulated
    runtime: Path  # folder of the daemon
    recordings: Path  # folder in which a recording would be written
    keys: Path | None  # folder of CURVE keys; None where telemetry needs none

    @property
    def board(self) -> str:
        """Vendor and product as lsusb writes them."""
        return f"{self.usb.vendor_id:04x}:{self.usb.product_id:04x}"


def requirements(
    settings: Settings, instance: str = DEFAULT_INSTANCE, recordings: Path | None = None
) -> Requirements:
    """What `settings` ask for the daemon `instance`.

    Recordings go to the working folder unless `recordings` names another.
    """
    servo = servo_params(settings, instance)
    keys = gateway_params(settings).curve_keys
    return Requirements(
        realtime=servo.realtime,
        usb=servo.usb,
        simulated=servo.simulated,
        runtime=untrusted_daemon_folder(instance),
        recordings=recordings or Path.cwd(),
        keys=Path(keys) if keys else None,
    )
