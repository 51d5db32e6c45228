"""A simulated device as a scene: all its effects, nothing rendered, the paper's perturbation."""

from hapticd.errors import ConfigError
from hapticd.plant.scene import Excitation, Scene
from hapticd.settings.build import device_effects
from hapticd.settings.device import Device
from hapticd.settings.document import read
from hapticd.settings.load import find_device, validated
from hapticd.settings.resources import shipped

TRIAL_S = 90.0


def device_scene(name: str) -> Scene | None:
    """The scene of the device file `name`; None if there is no such file, or none that can be simulated."""
    try:
        document = read(find_device(name, shipped("config") / "hapticd.toml", "device"))
    except ConfigError:
        return None
    device = validated(Device, document.data, document.where)
    effects = device_effects(device)
    if not effects:
        return None
    return Scene(document.path.stem, device.name, document.path.stem, effects, excitation=Excitation("noise"), seconds=TRIAL_S)
