"""The servo with the simulated board in its process, in blocks: the number of ticks that ended
beyond the next deadline, by cause, and the build of its interpreter.
"""

import sys

from benchmarks.bench_servo import BenchServo, read_parameters
from benchmarks.interpreter import this_interpreter
from benchmarks.worker import serve
from hapticd.core.units import MonotonicClock
from hapticd.run.servo_main import simulated_backend
from hapticd.usb.link import UsbLink


def main() -> None:
    """Run with the argument: parameter file."""
    params, board = read_parameters(sys.argv[1])
    servo = BenchServo(params, UsbLink(params.usb, simulated_backend(board, MonotonicClock())))
    build = this_interpreter()
    serve(
        lambda request: {"late": servo.late_ticks(request["ticks"]), "build": build},
        params.realtime,
        servo.enable,
    )


if __name__ == "__main__":
    main()
