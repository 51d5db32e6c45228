"""Runs a job in the user-mode kernel, on this machine's own root file system, read-only: same
Python, same libraries, another kernel.

The output of the job and its exit code are read from the console, where the guest's first process
writes one line at the end. The kernel itself always ends with 0. Its processes are one session, and
the remaining ones are killed.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from support.tree import ROOT

INIT = Path(__file__).with_name("usb_guest") / "init"
MEMORY_MB = 512
END = re.compile(r"^GUEST-END (\d+)\r?$", re.MULTILINE)


class Outcome(NamedTuple):
    """How a job ended."""

    code: int | None  # of the job; None: not reported by the guest
    text: str  # all of its console


def run(kernel: Path, job: str, limit_s: float) -> Outcome:
    """Run the shell script `job` in a guest of `kernel`, in the checkout's folder."""
    with tempfile.TemporaryDirectory(prefix="hapticd-guest-") as folder:
        script = Path(folder) / "job"
        script.write_text(job)
        text = _console(_command(kernel, script), limit_s)
    codes = END.findall(text)
    return Outcome(int(codes[-1]) if codes else None, text.replace("\r\n", "\n"))


def _command(kernel: Path, script: Path) -> list[str]:
    """Words without a = or with a capital letter go to the guest's first process."""
    return [
        str(kernel),
        f"mem={MEMORY_MB}M",
        f"uml_dir={script.parent}/",
        "con=null",
        "con0=null,fd:1",
        "ssl=null",
        *("root=/dev/root", "rootfstype=hostfs", "rootflags=/", "ro", f"init={INIT}"),
        *("quiet", "loglevel=1", "panic=-1"),
        *(f"JOB={script}", f"FOLDER={ROOT}", f"PYTHON={sys.executable}", f"PYTHONPATH={ROOT}"),
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD=1",
    ]


def _console(command: list[str], limit_s: float) -> str:
    """Return the output up to the end, or of the first `limit_s`."""
    guest = subprocess.Popen(
        command,
        env={**os.environ, "TMPDIR": _memory_folder(), "GLIBC_TUNABLES": "glibc.pthread.rseq=0"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        preexec_fn=_settle,
    )
    try:
        said, _ = guest.communicate(timeout=limit_s)
    except subprocess.TimeoutExpired as late:
        said = (late.stdout or b"") + b"\nGUEST-LATE\n"
    finally:
        _end(guest)
    return said.decode(errors="replace")


def _settle() -> None:
    """Runs in the guest's process, before it begins. It has one processor: on several cores its
    processes would wake each other across them. It also gets a higher priority than other programs
    where permitted, because its transfers have time-outs.
    """
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with suppress(OSError):
        Path("/proc/self/autogroup").write_text("-15")


def _memory_folder() -> str:
    """Where its memory is a file: in memory, if there is room."""
    shared = Path("/dev/shm")
    fits = shared.is_dir() and shutil.disk_usage(shared).free > MEMORY_MB << 20
    return str(shared) if fits else tempfile.gettempdir()


def _end(guest: "subprocess.Popen[bytes]") -> None:
    """Kill the remaining processes of the guest: a session with several process groups."""
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            pid, _, fields = stat.read_text().partition(" (")
            session = int(fields.rpartition(") ")[2].split()[3])
            if session == guest.pid:
                os.kill(int(pid), signal.SIGKILL)
        except OSError:
            continue  # it ended meanwhile
    guest.wait()
    assert guest.stdout is not None
    guest.stdout.close()
