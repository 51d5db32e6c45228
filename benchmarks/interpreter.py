"""Build of the running interpreter, as in `hapticd doctor`: a tick is Python, so each result
depends on the build.
"""

from typing import NamedTuple

from hapticd.run.doctor.machine import this_machine
from hapticd.run.doctor.probes import Flaw, judged_build


class Interpreter(NamedTuple):
    """`optimised`: not known to lack profile-guided optimisation."""

    text: str
    optimised: bool


def this_interpreter() -> Interpreter:
    """Return the interpreter of this process."""
    found = judged_build(this_machine().build)
    if isinstance(found, Flaw):
        return Interpreter(found.found, optimised=False)
    return Interpreter(found, optimised=True)
