"""The order of the interlocks, and that the early answers of the state interlock are the
servo's own.
"""

from pathlib import Path
from typing import Any

import pytest
from support.gateway_rig import CommandServerRig
from support.gateway_stand_in import NEXT_STATE

from hapticd.core.errors import CommandError
from hapticd.mailbox.daemons import ACTOR_STOP_WORD
from hapticd.mailbox.layout import Command, Result, State
from hapticd.protocol import commands
from hapticd.protocol.commands import ALLOWED
from hapticd.protocol.journal import RESERVED
from hapticd.servo import safety

OTHER = 99  # an actor that holds nothing
TABLED = (
    Command.ENABLE,
    Command.DISABLE,
    Command.STOP,
    Command.RESET,
    Command.ZERO,
    Command.HOME,
    Command.PERTURB_START,
)


@pytest.fixture
def rig(tmp_path: Path) -> CommandServerRig:
    return CommandServerRig(tmp_path)


def situation(rig: CommandServerRig, settled: bool = True, samples: int = 0) -> commands.Situation:
    return commands.Situation(
        rig.server.limits, rig.view, settled, samples, rig.server.leases, rig.server.actors
    )


def test_order_is_schema_state_lease(rig: CommandServerRig) -> None:
    rig.ask(cmd="lease", what="environment", action="take")
    rig.ask(cmd="stop")

    def objection(**request: Any) -> str:
        with pytest.raises(CommandError) as caught:
            commands.admit(request, OTHER, situation(rig))
        return caught.value.code

    assert objection(cmd="enable", force=1) == "invalid"
    assert objection(cmd="enable") == "stopped"
    assert objection(cmd="set", K=1.0) == "leased"


@pytest.mark.parametrize("kind", TABLED)
@pytest.mark.parametrize("state", State)
def test_early_answer_is_that_of_the_safety_table(kind: Command, state: State) -> None:
    allowed = ALLOWED.get(
        "perturb" if kind == Command.PERTURB_START else kind.name.lower(), tuple(State)
    )
    assert (state in allowed) == (not isinstance(safety.transition(state, kind), Result))


@pytest.mark.parametrize("kind", TABLED)
@pytest.mark.parametrize("state", State)
def test_stand_in_obeys_the_safety_table(kind: Command, state: State) -> None:
    assert (state in NEXT_STATE[kind]) == (not isinstance(safety.transition(state, kind), Result))


def test_actor_of_the_stop_page_is_the_servos() -> None:
    assert RESERVED[ACTOR_STOP_WORD] == "stop word"


def test_what_nobody_holds_is_not_forbidden(rig: CommandServerRig) -> None:
    request = commands.parse({"cmd": "enable"}, rig.server.limits)
    assert commands.forbidden(request, OTHER, rig.server.leases) is None


def test_first_objection_is_the_answer(rig: CommandServerRig) -> None:
    rig.ask(cmd="stop")
    with pytest.raises(CommandError) as caught:
        commands.admit({"cmd": "enable", "force": 1}, 16, situation(rig))
    assert caught.value.code == "invalid"


def test_unsettled_state_is_left_to_the_servo(rig: CommandServerRig) -> None:
    rig.ask(cmd="stop")
    assert commands.admit({"cmd": "enable"}, 16, situation(rig, settled=False)).cmd == "enable"


def test_start_without_waveform_is_refused(rig: CommandServerRig) -> None:
    with pytest.raises(
        CommandError, match=r"perturb start: no waveform is loaded; .*`hapticd perturb load FILE`"
    ):
        commands.admit({"cmd": "perturb", "action": "start"}, 16, situation(rig))


def test_start_at_a_rate_at_which_samples_are_lost_is_refused(rig: CommandServerRig) -> None:
    rig.ask(cmd="enable")
    request = {"cmd": "perturb", "action": "start"}
    assert commands.admit(request, 16, situation(rig, samples=100)).cmd == "perturb"
    rig.servo.mailbox.report({"unsampled": "a frame carries 6 of 8 samples"})
    with pytest.raises(CommandError, match="perturb start: a frame carries 6 of 8 samples"):
        commands.admit(request, 16, situation(rig, samples=100))
