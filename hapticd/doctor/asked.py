"""What the configuration asks of the machine, as far as the checks care."""

from dataclasses import dataclass
from pathlib import Path

from hapticd.mailbox.files import DEFAULT_INSTANCE, daemon_folder
from hapticd.params import RealtimeParams, UsbParams
from hapticd.settings.build import gateway_params, servo_params
from hapticd.settings.load import Settings


@dataclass(frozen=True)
class Asked:
    """`runtime`: folder of the daemon; `recordings`: where a recording would be written; `keys`: folder of CURVE keys."""

    realtime: RealtimeParams
    usb: UsbParams
    simulated: bool
    runtime: Path
    recordings: Path
    keys: Path | None

    @property
    def board(self) -> str:
        """Vendor and product as lsusb writes them."""
        return f"{self.usb.vendor_id:04x}:{self.usb.product_id:04x}"


def asked_of(settings: Settings, instance: str = DEFAULT_INSTANCE, recordings: Path | None = None) -> Asked:
    """What `settings` ask for the daemon `instance`; recordings go to the working folder unless told otherwise."""
    servo, keys = servo_params(settings, instance), gateway_params(settings).curve_keys
    return Asked(
        realtime=servo.realtime,
        usb=servo.usb,
        simulated=servo.simulated,
        runtime=daemon_folder(instance),
        recordings=recordings or Path.cwd(),
        keys=Path(keys) if keys else None,
    )
