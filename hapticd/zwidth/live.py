"""A trial on the device of a daemon: enable, set, perturb, record at 4 kHz, force off.

The daemon may be the real one or the same stack on virtual time (`simulated`); the client is the
same. The trial begins disabled and ends disabled, and never takes over another client's session. It
holds the measuring lease meanwhile. No other client can then change anything, and neither the guard
nor the energy faults end a trial at the edge of stability; the monitor does. Both are restored when
the lease ends: with the trial, with its process, or when that hangs. If another client takes over
the lease, it controls the device; the trial is undecided and leaves the device alone.

Two streams are received meanwhile: the probe's samples, and the servo's ticks. The ticks hold every
command, the winding's temperature, the position, the slots that were left out, and the revision of
the set-up, so that a change by any client ends the trial. Lost samples are filled and counted by
`watch`.

Doubtful calibrations are refused (`recording.provenance`), or named with the record and its
verdict.

Limitations: a board without probe inputs (refused); a host so busy that slots are lost (reported,
then undecided); ticks and samples that arrive far apart, although the same servo sends both.
"""

import datetime
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from math import nan
from typing import Any

import numpy as np

from hapticd.client.blocks import Block, BlockDecoder
from hapticd.client.client import Client, ClientLease
from hapticd.core.arrays import Flags, Floats
from hapticd.core.errors import AnalysisError, CommandError, DaemonDown
from hapticd.core.params import to_plain
from hapticd.core.units import PROBE_RATE_HZ
from hapticd.mailbox.layout import LOST_SLOTS, Flag, State, Watched
from hapticd.model.excitation import marked, torque_record
from hapticd.protocol.answers import Status
from hapticd.recording.provenance import CalibrationDoubt, certificate_of, doubts
from hapticd.zwidth.alignment import find_marks
from hapticd.zwidth.sources import Source, Trial
from hapticd.zwidth.store import MARK_SAMPLE, EndReason, Progress, TrialEnd, TrialRecord, silent
from hapticd.zwidth.watch import GapFiller, TrialMonitor

__all__ = ["allowed_waveform", "daemon_source"]

LEASE_S = 5.0  # a trial that hangs for longer has ended
RENEW_S = 1.0
WAVEFORM_S = 120.0  # a longer trial repeats it
SPARE_S = 10.0  # of waveform beyond the trial: settling, and samples that arrive late
ROOM = 0.97  # of the allowed peak, for a noise of another density
SETTLE_S = 1.0  # of perturbed motion before the record begins
PROBE = "probe"
TICKS = "servo.raw"
LOOK_S = 0.05
SILENT_LOOKS = 40  # without a message: 2 s
CHANGED = TrialEnd(
    EndReason.CHANGED,
    "another client changed the environment or the perturbation; disconnect other clients, and"
    " repeat the trial",
)

SLOW = TrialEnd(
    EndReason.SLOW_START,
    "the gain was still rising when the record began, for an enable so far from where"
    " the spring rests brings in more than limits.ramp_energy_j in a second; move the handle there,"
    " and repeat the trial",
)
ENDS = {
    "stopped": EndReason.STOPPED,
    "fault": EndReason.FAULT,
    None: EndReason.SERVO_DOWN,
}  # by the servo's state; any other is a disable


def daemon_source(bench: Client, origin: str = "daemon", uncalibrated: bool = False) -> Source:
    """Return a source of trials on the device of a daemon. AnalysisError unless it is `disabled`,
    and for doubtful calibrations, unless accepted with `uncalibrated`.
    """

    def record(trial: Trial, tell: Progress = silent) -> TrialRecord:
        servo = to_plain(bench.hello().servo)
        doubtful = doubts(servo, datetime.date.today(), probed=True)
        if not uncalibrated:
            refuse_doubts(doubtful)
        state = bench.status().state
        if state != "disabled":
            raise AnalysisError(
                f"the servo is {state}, a trial begins from disabled; end the session with `hapticd"
                " disable`"
            )
        stiffness, damping, mass = trial.environment
        waveform = allowed_waveform(trial, float(servo["device"]["probe_limit_n"]))
        lease = bench.lease("measuring", ttl_s=LEASE_S, at_end="disable")
        lease.take()
        try:
            bench.set(K=stiffness, B=damping, M=mass, active_damping=trial.active_damping_ns_per_m)
            bench.damping("on" if trial.active_damping_ns_per_m else "off")
            bench.perturb_load(waveform)
            bench.enable()
            bench.wait_for("enabled")
            bench.perturb_start(
                loop=waveform.size < PROBE_RATE_HZ * (trial.seconds + SPARE_S)
            )  # it ends if this process is killed
            return LiveRecording(bench, servo, doubtful, trial, lease).recorded(origin, tell)
        finally:
            _leave(bench, lease)

    return record


def _waveform(trial: Trial) -> Floats:
    if trial.waveform_n is not None:
        return trial.waveform_n
    if trial.mark and trial.seconds > WAVEFORM_S - SPARE_S:
        raise AnalysisError(
            f"a marked trial of {trial.seconds:g} s: the perturbation repeats after"
            f" {WAVEFORM_S:g} s, with its mark; take {WAVEFORM_S - SPARE_S:g} s or less"
        )
    force_n = torque_record(
        trial.excitation,
        round(PROBE_RATE_HZ * min(WAVEFORM_S, trial.seconds + SPARE_S)),
        trial.excitation.seed,
    )
    return marked(force_n) if trial.mark else force_n


def allowed_waveform(trial: Trial, limit_n: float) -> Floats:
    """Return the perturbation (n,) [N] at 4 kHz. AnalysisError above the probe's `limit_n`."""
    waveform = _waveform(trial)
    peak_n = float(np.abs(waveform).max())
    if peak_n <= limit_n:
        return waveform
    remedy = f"let it reach {limit_n:g} N at most"
    if trial.waveform_n is None:
        less = trial.excitation.psd_n2_per_hz * (ROOM * limit_n / peak_n) ** 2
        remedy = f"--psd {less:.2g} stays below; a weaker noise needs a longer trial"
    raise AnalysisError(
        f"the perturbation reaches {peak_n:.3g} N, and the device file allows {limit_n:g} N"
        f" (limits.probe_n): {remedy}"
    )


def _leave(bench: Client, lease: ClientLease) -> None:
    """Switch the force off in any case; a stop or a fault has done so already. If the lease was
    lost, do nothing: the device was disabled with it, or another client holds it.
    """
    try:
        lease.renew()
    except CommandError:
        return
    try:
        bench.perturb_stop()
    finally:
        if bench.status().state == "enabled":
            bench.disable()
        lease.release()


class LiveRecording:
    """One trial during reception: the probe's samples so far, and a summary of the ticks."""

    def __init__(
        self,
        daemon: Client,
        servo: Mapping[str, Any],
        doubtful: tuple[CalibrationDoubt, ...],
        trial: Trial,
        lease: ClientLease,
    ) -> None:
        """`servo` is the content of its hello, `doubtful` the doubtful calibrations."""
        self._lease = lease
        self._renewed = 0  # samples
        ends = servo["environment"]["workspace"]
        self._limit_n = min(servo["safety"]["force_limit_n"], servo["device"]["force_limit_n"])
        self._daemon = daemon
        self._doubtful = doubtful
        self._certificate = certificate_of(servo)
        self._seconds = trial.seconds
        self._marked = trial.mark
        watch = replace(
            trial.watch, command_limit_n=self._limit_n, travel_m=(ends["lower_m"], ends["upper_m"]),
            speed_limit_m_per_s=servo["device"]["speed_limit_m_per_s"],
        )  # fmt: skip
        self._monitor = TrialMonitor(watch, PROBE_RATE_HZ)
        self._gaps = GapFiller()
        # (2, n) force and velocity, and which were received
        self._parts: list[tuple[Floats, Flags]] = []
        self._taken = 0  # samples
        self._command_n = 0.0  # largest so far
        self._positions_m = (nan, nan)  # minimum and maximum since the last check
        self._began: Any = None  # the first tick that was perturbed
        self._newest: Any = None  # tick

    @property
    def _ended(self) -> bool:
        """Whether the servo is no longer enabled, or renders something else than when the
        perturbation began.
        """
        return self._newest is not None and (
            self._newest["state"] != State.ENABLED or self._changed
        )

    @property
    def _changed(self) -> bool:
        return self._began is not None and bool(self._newest["revision"] != self._began["revision"])

    def _slow_start(self, settle: int) -> TrialEnd | None:
        """Return why the record cannot begin with this block, the first one after `settle` samples:
        ramps that wait for their energy last longer than that.
        """
        before = self._taken - self._parts[-1][1].size
        rising = self._newest is not None and self._newest["gain"] < 1.0
        return SLOW if before <= settle and rising else None

    @property
    def _winding_c(self) -> float:
        return nan if self._newest is None else float(self._newest["winding_c"])

    def recorded(self, origin: str, tell: Progress) -> TrialRecord:
        """Receive until the end, or until the monitor or the servo ends the trial. DaemonDown if no
        samples arrive for 2 s.
        """
        settle = round(SETTLE_S * PROBE_RATE_HZ)
        ended = None
        wanted = settle + round(self._seconds * PROBE_RATE_HZ)
        for block in self._probe_blocks():
            self._take(block)
            self._renew()
            tell(
                self._monitor.outlook,
                round(self._taken / PROBE_RATE_HZ),
                round(wanted / PROBE_RATE_HZ),
            )
            if self._taken > settle:
                force, velocity = self._parts[-1][0]
                ended = self._slow_start(settle) or self._monitor.see(
                    force, velocity, self._winding_c, self._command_n, self._positions_m
                )
            self._positions_m = (nan, nan)  # positions before settling do not count
            if ended or self._taken >= wanted:
                break
        if not self._parts:
            raise AnalysisError(
                "the probe stream is empty: this board has no probe inputs; record with another"
                " system and import it"
            )
        status = self._daemon.status()
        force, velocity = np.concatenate([part for part, _ in self._parts], axis=1)[
            :, settle:wanted
        ]
        return TrialRecord(
            force, velocity, PROBE_RATE_HZ, origin, status.simulated is not False,
            ended or _gone(status) or (CHANGED if self._changed else None),
            self._command_n, self._limit_n, self._more(settle, wanted, status),
        )  # fmt: skip

    def _renew(self) -> None:
        """Renew the lease. The ticks show its loss: the perturbation ends with it."""
        if self._taken - self._renewed >= RENEW_S * PROBE_RATE_HZ:
            self._renewed = self._taken
            with suppress(CommandError):
                self._lease.renew()

    def _more(self, settle: int, wanted: int, status: Status) -> dict[str, Any]:
        came = np.concatenate([known for _, known in self._parts])[settle:wanted]
        lost = slots = 0
        if self._began is not None:
            # the counter wraps there
            lost = (int(self._newest["lost_slots"]) - int(self._began["lost_slots"])) % LOST_SLOTS
            slots = int(self._newest["tick"]) - int(self._began["tick"]) + 1 + lost
        return {
            **self._mark(settle),
            "lost_samples": int((~came).sum()),
            "samples": came.size,
            "lost_slots": lost,
            "slots": slots,
            "winding_c": self._winding_c,
            "limit_cycle_faults": bool(self._newest["watches"] & Watched.FORCE_AT_LIMIT)
            if self._newest is not None
            else None,
            "guard_policy": "off" if "measuring" in status.leases else None,
            "config_hash": status.config_hash,
            "calibration_doubts": [str(one) for one in self._doubtful],
            "certificate": self._certificate,
        }

    def _mark(self, settle: int) -> dict[str, int]:
        """Return where the mark began, in samples of the record; {} without one."""
        if not self._marked:
            return {}
        marks = find_marks(np.concatenate([values[0] for values, _ in self._parts])[:settle])
        return {MARK_SAMPLE: marks[0].row - settle} if marks else {}

    def _probe_blocks(self) -> Iterator[Block]:
        """Yield blocks of the probe, after reading the ticks before each; stop when the servo is no
        longer enabled or was changed.
        """
        decoders = {PROBE: BlockDecoder(), TICKS: BlockDecoder()}
        quiet = 0
        for message in self._daemon.messages((PROBE, TICKS), LOOK_S):
            quiet = quiet + 1 if message is None else 0
            if message is None:
                if quiet > SILENT_LOOKS or self._ended:
                    break
                continue
            block = decoders[message[0]].decode(message[1])
            if message[0] == TICKS:
                self._hear(block.records)
            elif len(block.records):
                yield block
        if not self._ended and not _gone(self._daemon.status()):
            raise DaemonDown(
                f"nothing from the probe for {SILENT_LOOKS * LOOK_S:g} s; see `hapticd status`"
            )

    def _hear(self, ticks: Any) -> None:
        if not len(ticks):
            return
        clamped = bool((ticks["flags"] & Flag.CLAMPED).any())
        self._command_n = max(
            self._command_n, self._limit_n if clamped else float(np.abs(ticks["force_n"]).max())
        )
        # fmin and fmax ignore the initial NaN
        at_m = [*self._positions_m, *ticks["position_m"]]
        self._positions_m = (float(np.fmin.reduce(at_m)), float(np.fmax.reduce(at_m)))
        playing = ticks[ticks["perturbing"] != 0]
        if self._began is None and len(playing):
            self._began = playing[0]
        self._newest = ticks[-1]

    def _take(self, block: Block) -> None:
        self._parts.append(self._gaps.filled(block.records["index"], block.signals()))
        self._taken += self._parts[-1][1].size


def _gone(status: Status) -> TrialEnd | None:
    """Return why the servo is no longer enabled; None if it is."""
    state = status.state
    if state == "enabled":
        return None
    reason = ENDS.get(state, EndReason.DISABLED)
    cause = status.cause if reason is not EndReason.DISABLED else ""
    fault = status.fault if reason is EndReason.FAULT else ""
    return TrialEnd(reason, cause or "another client ended it", fault)


def refuse_doubts(found: tuple[CalibrationDoubt, ...]) -> None:
    """Raise AnalysisError that lists `found`, if there are any."""
    if found:
        steps = ", ".join(dict.fromkeys(one.remedy for one in found))
        listed = "; ".join(map(str, found))
        raise AnalysisError(
            f"calibrations that cannot be relied on: {listed}. Measure them ({steps}), or ask for"
            " the trial with --uncalibrated: its verdict then says so"
        )
