"""The servo's state in words: the content of the topic `state`, and the events in a block of records."""

from typing import Any

import numpy as np

from hapticd.faults import BY_NUMBER, FAULTS, Fault
from hapticd.gateway.actors import Actors
from hapticd.gateway.events import Journal
from hapticd.gateway.feed import Block
from hapticd.gateway.view import STATES, ServoView
from hapticd.units import NS_PER_S

SHOWN = (
    "tick", "homed", "perturbing", "gain", "stiffness_n_per_m", "damping_ns_per_m", "mass_kg", "added_damping_asked_ns_per_m",
    "added_damping_ns_per_m", "position_m", "force_n", "winding_c", "actor",
)  # fmt: skip
NEWS = ("state", "fault", "revision", "actor", "homed", "perturbing")  # a change of one of these is published at once


def state_map(view: ServoView, actors: Actors, unix_ns: int) -> dict[str, Any]:
    """Everything a lamp, a title bar or a late joiner needs to know."""
    mailbox, record, fault = view.mailbox, view.record, view.fault
    header = mailbox.header if mailbox else None
    return {
        "timestamp": unix_ns / NS_PER_S,
        "servo_alive": view.alive,
        "state": view.state_name,
        "simulated": header.simulated if header else view.params.simulated,
        "rate_hz": header.rate_hz if header else view.params.realtime.rate_hz,
        "revision": view.revision,
        "fault": fault.code,
        **described(fault),
        "instance": view.params.instance,
        "epoch": header.start_ns if header else 0,
        "config_hash": header.config_hash if header else view.params.config_hash,
        **{name: record[name] for name in SHOWN if view.alive and name in record},
        "actor_name": actors.name(int(record.get("actor", 0))),
        "actors": actors.names(),
        "counters": mailbox.counters() if mailbox else {},
    }


def described(fault: Fault) -> dict[str, str]:
    """Cause, action and remedy of a fault."""
    return {"cause": fault.cause, "action": fault.action, "remedy": fault.remedy}


def news(view: ServoView) -> tuple[Any, ...]:
    """What is compared to see whether the state has changed."""
    return view.alive, view.life, *(view.record.get(name) for name in NEWS)


class Transitions:
    """Follows states and faults from block to block and notes every change with its tick, however short it was."""

    def __init__(self, view: ServoView, actors: Actors, journal: Journal) -> None:
        self._view, self._actors, self._journal = view, actors, journal
        self._life, self._last = 0, (0, 0)

    def follow(self, block: Block) -> None:
        """Note the changes in `block`, and the gap before it."""
        if self._life != block.life:
            self._life, self._last = block.life, (0, 0)
        if block.lost:
            self._journal.note("gap", seq=block.seq, lost=block.lost)
        states, faults = block.records["state"], block.records["fault"]
        before_states = np.concatenate(([self._last[0]], states[:-1]))
        before_faults = np.concatenate(([self._last[1]], faults[:-1]))
        for place in np.flatnonzero((states != before_states) | (faults != before_faults)).tolist():
            self._note(block.records[place], int(before_states[place]))
        if len(states):
            self._last = int(states[-1]), int(faults[-1])

    def _note(self, record: np.void, before: int) -> None:
        fault = BY_NUMBER.get(int(record["fault"]), FAULTS[0])
        actor = int(record["actor"])
        self._journal.note(
            "state",
            unix_ns=int(record["time_ns"]) + self._view.unix_offset_ns,
            tick=int(record["tick"]),
            before=_name(before),
            state=_name(int(record["state"])),
            fault=fault.code,
            **described(fault),
            actor=actor,
            name=self._actors.name(actor),
        )


def _name(number: int) -> str:
    return STATES[number].name.lower() if number in STATES else f"unknown ({number})"
