"""What stands between a client and the servo: an ordered list, each asking one question. The first one that objects answers.

    schema     is it a command, complete, within the limits of this device?
    state      would the servo refuse it anyway in its present state? (Only an early, better explained answer: the servo decides.)
    lease      may this client change this now? (Everyone may.)
    passivity  is the display still passive with these parameters? (Not asked.)

An interlock takes what is asked and the scene, and returns what is asked, possibly completed or altered; it raises
CommandError to refuse. STOP passes none of them.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from hapticd.errors import CommandError
from hapticd.gateway.commands import ALLOWED, wrong_state
from hapticd.gateway.explain import parse
from hapticd.gateway.limits import Limits
from hapticd.gateway.schemas import Change, Perturb, Request
from hapticd.gateway.view import ServoView
from hapticd.mailbox.layout import State


class Asked(NamedTuple):
    """A request on its way: as it came, as the schema interlock understood it, and whose it is."""

    plain: dict[str, Any]
    actor: int
    request: Request | None = None


class Scene(NamedTuple):
    """What an interlock may look at. `settled`: no command is on its way, so the newest record tells the state."""

    limits: Limits
    view: ServoView
    settled: bool
    samples: int  # of the waveform that is loaded


Interlock = Callable[[Asked, Scene], Asked]


def schema(asked: Asked, scene: Scene) -> Asked:
    """Understand the request."""
    return asked._replace(request=parse(asked.plain, scene.limits))


def state(asked: Asked, scene: Scene) -> Asked:
    """Refuse early what the servo would refuse in the state it is in."""
    request, view = asked.request, scene.view
    if isinstance(request, Change):
        _check_revision(request, scene)
    if isinstance(request, Perturb) and request.action != "start":
        return asked
    if isinstance(request, Perturb) and not scene.samples:
        raise CommandError("refused", "perturb start: no waveform is loaded; send it with action load first")
    if request and scene.settled and view.state not in (None, *ALLOWED.get(request.cmd, State)):
        raise wrong_state(request.cmd, view)
    return asked


def lease(asked: Asked, scene: Scene) -> Asked:
    """Everyone may change everything."""
    return asked


def passivity(asked: Asked, scene: Scene) -> Asked:
    """Every set of parameters passes."""
    return asked


INTERLOCKS: tuple[Interlock, ...] = (schema, state, lease, passivity)


def admit(plain: dict[str, Any], actor: int, scene: Scene) -> Request:
    """The request in `plain` once every interlock has let it pass. CommandError by the first that does not."""
    asked = Asked(plain, actor)
    for interlock in INTERLOCKS:
        asked = interlock(asked, scene)
    if asked.request is None:
        raise CommandError("invalid", "no interlock understood the request")
    return asked.request


def _check_revision(request: Change, scene: Scene) -> None:
    if "if_rev" not in request.model_fields_set:
        return
    if not scene.settled:
        raise CommandError("busy", f"if_rev = {request.if_rev}: another change is on its way; read the revision and ask again")
    if request.if_rev != scene.view.revision:
        raise CommandError(
            "refused", f"if_rev = {request.if_rev}: the revision is {scene.view.revision}; look at what changed and ask again"
        )
