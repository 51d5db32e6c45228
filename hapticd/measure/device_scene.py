"""A simulated device as a scene: all its effects, nothing rendered, the paper's perturbation."""

from hapticd.errors import ConfigError
from hapticd.plant.bodies import Masses, Viscous, WorkspaceEnds
from hapticd.plant.effects import Effect
from hapticd.plant.electrical import Delay
from hapticd.plant.scene import Excitation, Scene
from hapticd.plant.winding import Motor
from hapticd.settings.build import DEFAULT_PHASE, converter_effects, device_effects
from hapticd.settings.device import Device, Plant
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
    effects = _rigid(device, device.plant) if device.plant else device_effects(device)
    if not effects:
        return None
    return Scene(document.path.stem, device.name, document.path.stem, effects, excitation=Excitation("noise"), seconds=TRIAL_S)


def scene_of_device(title: str) -> Scene | None:
    """The scene of the shipped device file that gives its device this name; None if there is none, or none to simulate."""
    for path in sorted((shipped("config") / "devices").glob("*.toml")):
        if read(path).data.get("name") == title:
            return device_scene(path.stem)
    return None


def _rigid(device: Device, plant: Plant) -> tuple[Effect, ...]:
    """The one mass that the simulated board moves without a model of effects, latched when it does by default."""
    return (
        Masses(rotor_kg=plant.mass_kg),
        Motor(torque_constant_nm_per_a=plant.torque_constant_n_per_a, lever_m=1.0, resistance_ohm=plant.winding_ohm),
        Viscous(rotor_ns_per_m=plant.viscous_ns_per_m),
        WorkspaceEnds(lower_m=plant.lower_stop_m, upper_m=plant.upper_stop_m),
        Delay(periods=1.0 - DEFAULT_PHASE),
        *converter_effects(device).values(),
    )
