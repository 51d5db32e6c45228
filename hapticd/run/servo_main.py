"""The servo process: `python -m hapticd.run.servo_main SERVO_JSON [BOARD_JSON]`.

`--parent PID` is the supervisor with which it ends.

Order of a start: parameters -> mailbox made -> board found, greeted, hash checked -> real-time
rights -> mailbox published, systemd notified -> loop. The servo waits for a board that is absent or
not ready. The reason is in servo.report, in systemd's status and in the log, once for each reason.
The first tick obeys a stop pressed during the wait. A simulated board (selected in SERVO_JSON,
described by BOARD_JSON) runs in this process and thread, behind the same pyusb. Exit code 0: ended
by a signal. Otherwise it is the `exit_code` of the error, which is printed in one line on stderr.
78: the configuration or, for half a minute, the board's protocol is wrong; 6: a right was refused
in strict mode (a restart would not help); 1: others.

No import at the top may load numpy, pydantic or zmq, or a simulator for a real board (import-linter
and a test check).
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapticd.core.errors import ConfigError, HapticdError
from hapticd.core.params import ServoParams, read_params
from hapticd.core.process import die_with_parent, on_stop, ordinary_scheduling, request_rights
from hapticd.core.units import NS_PER_S, NS_PER_US, US_PER_S, Clock, MonotonicClock
from hapticd.mailbox import files, layout
from hapticd.mailbox.servo_side import ServoMailbox
from hapticd.run.watchdog import notify, start_feeder
from hapticd.servo.late import spinning_wait
from hapticd.servo.loop import ServoLoop
from hapticd.usb.device import Device
from hapticd.usb.link import UsbLink
from hapticd.usb.search import BoardSearch

if TYPE_CHECKING:
    from hapticd.model.params import BoardParams
    from hapticd.sim.backend import SimulatedBackend


def simulated_backend(
    params: "BoardParams", clock: Clock, on_slip: Callable[[int], None] | None = None
) -> "SimulatedBackend":
    """Return a pyusb backend with one simulated board, and the faults in `params`.

    `on_slip(ns)` is called with the time that a paused host cost the simulation.
    """
    # imported here: a servo of a real board loads no simulator
    from hapticd.sim.backend import make_backend

    return make_backend(params, clock, on_slip)


def startup_message(text: str) -> None:
    """Send `text` as systemd's status of the unit and as a line of the log."""
    try:
        notify(f"STATUS={text}")
        os.write(2, f"hapticd servo: {text}\n".encode())
    except OSError:
        pass  # no reader is no reason to end a servo


class Servo:
    """The parts of one servo process."""

    def __init__(self, params: ServoParams, board: "BoardParams | None", clock: Clock) -> None:
        self.params = params
        self.clock = clock
        self.stopping = False
        self.loop: ServoLoop | None = None
        self.slip_ns = 0  # delay of a simulated board after pauses of the host
        backend = None
        if board is not None:
            backend = simulated_backend(board, clock, self._slipped)
        self.device = Device(UsbLink(params.usb, backend), params.realtime.rate_hz)
        self.mailbox: ServoMailbox | None = None

    def stop(self) -> None:
        """End at the next tick."""
        self.stopping = True
        if self.loop is not None:
            self.loop.stopping = True

    def run(self) -> None:
        """Make the mailbox, find the board, publish, and run the loop until `stop`."""
        params = self.params
        notify("STATUS=looking for the board")
        self.mailbox = ServoMailbox(
            files.runtime_folder(params.instance),
            params.realtime.rate_hz,
            params.config_hash,
            params.simulated,
            self.clock.now_ns(),
        )
        try:
            if self.connect(self.mailbox):
                self._serve(self.mailbox)
        finally:
            self.device.close()
            self.mailbox.close()

    def connect(self, mailbox: ServoMailbox) -> bool:
        """Wait until the board answers, and report the reason for waiting; False: `stop` was
        called.

        ProtocolMismatch if it has sent only wrong hashes for search.MISMATCH_NS.
        """

        def tell(reason: str) -> None:
            mailbox.report({"waiting_for": reason, **self._about()})
            startup_message(f"waiting for the board: {reason}" if reason else "the board answers")

        search = BoardSearch(self.device, tell)
        while not self.stopping:
            if search.look(self.clock.now_ns()) is not None:
                return True
            search.check_patience(self.clock.now_ns())
            self.clock.sleep_until_ns(search.retry_ns)
        return False

    def _serve(self, mailbox: ServoMailbox) -> None:
        """Run the loop until `stop`, and end it without force."""
        params = self.params
        rate_hz = params.realtime.rate_hz
        served = f"{rate_hz:g} Hz{', SIMULATED' if params.simulated else ''}"

        def tell(reason: str) -> None:
            startup_message(
                f"lost the board: {reason}" if reason else f"the board answers again, {served}"
            )

        wait = spinning_wait(int(params.realtime.spin_us * NS_PER_US), int(NS_PER_S / rate_hz))
        self.loop = ServoLoop(params, self.device, mailbox, self.clock, wait, tell)
        self.loop.stopping = self.stopping
        start_feeder(mailbox.folder)  # before the real-time rights, which it must not inherit
        try:
            check = self.loop.connection.check
            for one in check.differences:
                startup_message(f"not the board of the device file: {one}")
            for reason in filter(None, (check.uncompensated, check.unsampled)):
                startup_message(reason)
            plain = {name: one._asdict() for name, one in request_rights(params.realtime).items()}
            mailbox.report({"realtime": plain, **self._about(), **check.report()})
            mailbox.publish()
            notify("READY=1", f"STATUS={served}")
            self.loop.restart_clock()
            self.loop.run()
        finally:
            notify("STOPPING=1")
            try:
                self.loop.finish()  # in real time, like every tick: force may fade in it
            finally:
                ordinary_scheduling()

    def _about(self) -> dict[str, Any]:
        """Return device and rate for the mailbox's report."""
        return {
            "instance": self.params.instance,
            "device": f"{self.params.device.name}, {self.params.device.serial}",
            "simulated": self.params.simulated,
            "period_us": US_PER_S / self.params.realtime.rate_hz,
        }

    def _slipped(self, slip_ns: int) -> None:
        """Add `slip_ns` to the counter in the mailbox."""
        self.slip_ns += slip_ns
        if self.mailbox is not None:
            place = layout.COUNTER_WORD + layout.COUNTERS.index("sim_slip_ns")
            self.mailbox.words[place] = self.slip_ns


def main(arguments: list[str]) -> int:
    """Run a servo and return the exit code."""
    parent = int(arguments[arguments.index("--parent") + 1]) if "--parent" in arguments else None
    paths = [Path(item) for item in arguments if item.endswith(".json")]
    die_with_parent(parent)
    try:
        if not paths:
            raise ConfigError(
                "name the servo.json to start from; `hapticd config resolve` makes one"
            )
        params = read_params(ServoParams, paths[0])
        if params.simulated and len(paths) < 2:
            raise ConfigError(f"{paths[0]} is marked as simulated; pass the board.json too")
        board = None
        if params.simulated:
            from hapticd.model.params import BoardParams  # a servo of a real board loads no model

            board = read_params(BoardParams, paths[1])
        servo = Servo(params, board, MonotonicClock())
        on_stop(servo.stop)
        servo.run()
    except HapticdError as error:
        os.write(2, f"hapticd servo: {error}\n".encode())
        return error.exit_code
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
