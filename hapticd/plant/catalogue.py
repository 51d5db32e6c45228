"""Every effect there is, in the order of composition: modules as listed here, classes as written.

An effect that is written into one of these modules is in the catalogue; a scene names it by its
key. `ALWAYS` are built without being named.

What would break it: an effect that stands before one whose signals it takes up.
"""

from collections.abc import Iterable
from types import ModuleType

from hapticd.plant import bodies, electrical, friction, sensing, shaped_damping, winding
from hapticd.plant.effects import Effect

MODULES = (bodies, friction, electrical, shaped_damping, winding, sensing)


def _kinds(module: ModuleType) -> list[type[Effect]]:
    """The effects that the module defines, not those that it imports."""
    own = [item for item in vars(module).values() if getattr(item, "__module__", "") == module.__name__]
    return [item for item in own if isinstance(item, type) and issubclass(item, Effect)]


KINDS: tuple[type[Effect], ...] = tuple(kind for module in MODULES for kind in _kinds(module))
ALWAYS = (bodies.Masses.key, winding.Motor.key)
BY_KEY = {kind.key: kind for kind in KINDS}


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Sorted as they are composed."""
    keys = list(BY_KEY)
    return tuple(sorted(effects, key=lambda effect: keys.index(effect.key)))
