"""One K-B plane: `python -m hapticd.console.plane_worker GUARD_JSON PARENT < request > answer`.

It ends with its parent. Exit code 0: the answer is there, as a message for pages; otherwise what
went wrong is on stderr.
"""

import json
import os
import sys
from pathlib import Path

from hapticd.core.params import GuardSetup, from_plain
from hapticd.core.process import die_with_parent
from hapticd.guard.judge import Judge

NICENESS = 10


def main(path: str, parent: str) -> int:
    """Answer one request; the exit code."""
    die_with_parent(int(parent))
    os.nice(NICENESS)
    request = json.load(sys.stdin)
    setup = from_plain(GuardSetup, json.loads(Path(path).read_text()), path)
    told = {**Judge(setup).answer(request), "basis": request["basis"], "M": request["target"]["M"]}
    json.dump({"kind": "plane", "told": told}, sys.stdout)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(*sys.argv[1:]))
