"""Every process of a daemon under force is stopped, killed and crashed, at random moments.

What has to come of it: force never comes back by itself. A servo that died begins anew, disabled
and without force; whatever left `enabled` stays out of it until somebody asks; a gateway that is
silent for a second is a latched fault while it is still silent. Every process is there again, the
daemon answers, can be enabled, and obeys a stop, which it does as well while anything but the
servo is stopped. The force of a servo that is dead is the board's: what that does is flown in
lock-step (`boards.dead_servo`).
"""

import os
import signal
import time
from pathlib import Path
from random import Random
from typing import NamedTuple

from hapticd.mailbox import files
from hapticd.mailbox.layout import State
from hapticd.mailbox.stop_word import press_stop
from support.attacks.live import LiveDaemon, Watch, children, until
from support.attacks.rows import Losses, Outcome
from support.attacks.stage import QUIET, SETTINGS, shared

STOPPED_S = (0.02, 0.3, 1.6)
GATEWAY_PATIENCE_S = 1.0
SETTLED_S = 0.3  # in which nothing may come back by itself
DEADLY = (signal.SIGKILL, signal.SIGSEGV)


class Strike(NamedTuple):
    """Which process gets which signal."""

    name: str
    number: signal.Signals


ALL = tuple(
    Strike(name, number)
    for number in (signal.SIGSTOP, *DEADLY)
    for name in ("servo", "gateway", "guard", "console")
)


def order(random: Random) -> list[Strike]:
    """What one daemon goes through: everything once, its supervisor last."""
    strikes = [*ALL, Strike("supervisor", signal.SIGSTOP)]
    random.shuffle(strikes)
    return [*strikes, Strike("supervisor", random.choice(DEADLY))]


def attack(times: int, seed: int) -> Outcome:
    """`times` signals; the last of a daemon is for its supervisor."""
    random = Random(seed)
    losses = Losses()
    longest_ms = 0.0
    done = 0
    while done < times:
        strikes = order(random)
        strikes = strikes[-min(times - done, len(strikes)) :]
        console = any(one.name == "console" for one in strikes)
        with LiveDaemon(SETTINGS + (QUIET if shared else ""), console=console) as daemon:
            watch = Watch(daemon.folder)
            for strike in strikes:
                _one(daemon, watch, strike, random, losses)
            watch.close()
            longest_ms = max(longest_ms, watch.stop_longest_ms)
        done += len(strikes)
    return losses.outcome(times, stop_longest_ms=longest_ms)


def _one(daemon: LiveDaemon, watch: Watch, strike: Strike, random: Random, losses: Losses) -> None:
    try:
        until(lambda: _serves(daemon, strike.name), f"{strike.name} is there")
        daemon.to_force()
        time.sleep(random.uniform(0.0, 0.6))
        since_ns = time.monotonic_ns()
        lives = watch.lives
        _struck(daemon, watch, strike, random)
        until(daemon.state, "it answers")
        if strike.name in ("servo", "supervisor") and strike.number in DEADLY:
            until(lambda: watch.lives > lives, "the next servo")
            _stays_without_force(daemon, watch)
        _nothing_came_back(watch, since_ns)
        daemon.to_force()
        _stopped(daemon, watch)
    except AssertionError as error:
        losses.add(f"{strike.number.name} of the {strike.name}: {error}")


def _serves(daemon: LiveDaemon, name: str) -> bool:
    """Whether that process is there; of the page, which is left out if it never served, that it
    has said where it is.
    """
    there = name in daemon.processes()
    return there and (name != "console" or (daemon.folder / files.CONSOLE).exists())


def _struck(daemon: LiveDaemon, watch: Watch, strike: Strike, random: Random) -> None:
    pid = daemon.processes()[strike.name]
    os.kill(pid, strike.number)
    if strike.number == signal.SIGSTOP:
        stopped_s = random.choice(STOPPED_S)
        time.sleep(stopped_s)
        silent = strike.name == "gateway" and stopped_s > GATEWAY_PATIENCE_S
        if silent:
            until(lambda: watch.changes[-1].state == State.FAULT, "a silent gateway is a fault")
        if strike.name != "servo":
            _stopped(daemon, watch)
        os.kill(pid, signal.SIGCONT)
    elif strike.name == "supervisor":
        family = children(pid)
        until(lambda: not any(_lives(one) for one in family), "nobody outlives the supervisor")
        daemon.restart()
    else:
        until(lambda: daemon.processes().get(strike.name, pid) != pid, "another in its place")


def _stopped(daemon: LiveDaemon, watch: Watch) -> None:
    """A stop is obeyed; it is pressed while something else does not run."""
    since_ns = time.monotonic_ns()
    press_stop(daemon.folder)
    watch.stopped_ms(since_ns)


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def _stays_without_force(daemon: LiveDaemon, watch: Watch) -> None:
    """AssertionError if a new servo that nobody enabled was enabled or had force in any tick."""
    time.sleep(SETTLED_S)
    assert not watch.live_in_this_life, "force came back by itself"
    assert daemon.state() == "disabled", f"it came back {daemon.state()}"


def _nothing_came_back(watch: Watch, since_ns: int) -> None:
    """AssertionError if a state that had ended force became `enabled` again."""
    time.sleep(SETTLED_S)
    states = [one.state for one in watch.changes if one.time_ns >= since_ns]
    assert State.ENABLED not in states, f"enabled again by itself: {states}"
