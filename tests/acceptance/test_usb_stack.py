"""The daemon on a true Linux USB stack: usbcore, usbfs, libusb, udev and permissions, in a
user-mode kernel, with the product's own board behind USB/IP (docs/development/usb.md).

The cases stand in tests/support/usb_guest and run there, all in one boot; here each has a test
that looks
how it ended.
"""

import ast
import re
import shlex
import sys
import time
from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

import pytest
from support.tree import ROOT
from support.usb_kernel import kernel
from support.usb_machine import Outcome, run

GUEST = ROOT / "tests/support/usb_guest"
EVERYWHERE = ("link_cases.py", "daemon_cases.py")
ONCE = ("rights_cases.py",)
# a run with udevd, and one without it in a network namespace, where none of its messages would come
ALONE = ["unshare", "--net", "sh", "-c", 'ip link set lo up; NO_UDEV=1 exec "$@"', "sh"]
COMMANDS = Path("/proc")
REPORT = ROOT / "build" / "usb-stack.txt"
LIMIT_S = 420.0  # of the guest; a minute on two idle cores
BEGINS = "GUEST-RUN"  # what the guest says before each of its two runs
CASE = re.compile(r"^GUEST-CASE (\w+) (\w+)", re.MULTILINE)

# the first of them also waits for the kernel's build
pytestmark = [pytest.mark.process, pytest.mark.timeout(1500)]


class Case(NamedTuple):
    """A function that pytest finds in the guest, and in how many runs."""

    name: str
    runs: int


def cases(runs: int, files: tuple[str, ...]) -> Iterator[Case]:
    for file in files:
        for node in ast.parse((GUEST / file).read_text()).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
                yield Case(node.name, runs)


class Ended(NamedTuple):
    """How every run of every case ended."""

    outcome: Outcome
    runs: list[dict[str, set[str]]]  # of each, by the name of a case: "passed", and others


def pytest_words(*files: str) -> str:
    """The command that runs the cases of these files."""
    plugins = ("-p", "no:cacheprovider", "-p", "pytest_timeout")
    words = [sys.executable, "-m", "pytest", "-vv", "--color=no", "--durations=8", *plugins]
    return shlex.join([*words, f"--confcutdir={GUEST}", *(str(GUEST / file) for file in files)])


@pytest.fixture(scope="module")
def ended() -> Ended:
    """All cases, in one boot of the kernel."""
    first = f"echo {BEGINS}; {shlex.join(ALONE)} {pytest_words(*EVERYWHERE)}"
    # the last case leaves its mark on the kernel
    second = pytest_words(*EVERYWHERE, *ONCE)
    script = f"{first}; code=$?\necho {BEGINS}; {second} && exit $code"
    outcome = run(kernel(), script, LIMIT_S)
    REPORT.parent.mkdir(exist_ok=True)
    REPORT.write_text(outcome.text)
    runs: list[dict[str, set[str]]] = []
    for text in re.split(rf"^{BEGINS}\r?$", outcome.text, flags=re.MULTILINE)[1:]:
        runs.append({})
        for how, name in CASE.findall(text):
            runs[-1].setdefault(name, set()).add(how)
    return Ended(outcome, runs)


def test_guest_ran_to_its_end(ended: Ended) -> None:
    assert ended.outcome.code == 0, ended.outcome.text


@pytest.mark.parametrize("case", [*cases(2, EVERYWHERE), *cases(1, ONCE)], ids=itemgetter(0))
def test_case_holds_on_the_true_stack(case: Case, ended: Ended) -> None:
    found = [one[case.name] for one in ended.runs if case.name in one]
    assert found == [{"passed"}] * case.runs, f"{REPORT} has all that the guest said"


def test_rates_were_measured(ended: Ended) -> None:
    told = re.findall(r"^GUEST-TOLD (.*)$", ended.outcome.text, re.MULTILINE)
    print("\n".join(told))
    assert {line.partition(":")[0] for line in told} == {"rate", "calls", "daemon"}


def test_guest_that_hangs_is_ended_with_all_its_processes() -> None:
    outcome = run(kernel(), "echo begun; sleep 1000 & sleep 1000", 5.0)
    assert outcome.code is None
    assert "GUEST-LATE" in outcome.text
    deadline = time.monotonic() + 60.0
    while any(f"FOLDER={ROOT}".encode() in words(one) for one in COMMANDS.glob("*/cmdline")):
        assert time.monotonic() < deadline, "processes of the guest are left"
        time.sleep(0.05)


def words(command: Path) -> bytes:
    try:
        return command.read_bytes()
    except OSError:
        return b""  # it ended meanwhile
