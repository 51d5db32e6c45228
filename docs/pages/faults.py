"""The table of faults, and a page for each."""

from pathlib import Path

from hapticd.core.errors import CommandError
from hapticd.core.faults import FAULTS, Fault
from pages.markdown import table

NOTES = Path(__file__).parents[1] / "faults"  # notes on the diagnosis, one file per code
REFUSED_EXIT = CommandError("stopped", "").exit_code
INTRODUCTION = """# Faults

A fault is a reason for which the servo leaves `enabled` by itself. Every tick record and recording contains its number. State,
events, `hapticd status` and error messages contain its code.
"""
TABLE_OF_CONTENTS = """
```{{toctree}}
:hidden:

{pages}
```
"""
AFTERWARDS = """
Until `hapticd reset` the state is `{state}` and `enable` is refused with exit code {exit_code}; a reset is refused while the cause
persists. In a recording: `fault == {number}`.
"""


def faults_page() -> str:
    """Return the table of faults."""
    rows = [
        (str(fault.number), f"[`{fault.code}`]({fault.code}.md)", fault.cause, fault.remedy)
        for fault in FAULTS[1:]
    ]
    contents = TABLE_OF_CONTENTS.format(pages="\n".join(fault.code for fault in FAULTS[1:]))
    return f"{INTRODUCTION}\n{table(('number', 'code', 'cause', 'remedy'), rows)}{contents}"


def fault_page(fault: Fault) -> str:
    """Return one fault: the row of the table, and the notes."""
    rows = [
        ("number", str(fault.number)),
        ("cause", fault.cause),
        ("what happens", fault.action),
        ("remedy", fault.remedy),
    ]
    state = "stopped" if fault.code == "stop" else "fault"
    after = AFTERWARDS.format(state=state, exit_code=REFUSED_EXIT, number=fault.number)
    return f"# {fault.code}\n\n{table(('', ''), rows)}\n{(NOTES / f'{fault.code}.md').read_text()}{after}"
