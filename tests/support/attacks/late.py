"""Late ticks of a daemon under attack, compared with a control that uses the same CPU time.

Blocks of BLOCK_S alternate between attack and control, so that a pause of the machine affects both
alike. In an attack block three peers flood, storm and crowd the gateway, and the CPU time of the
peers and the gateway is measured. In the following control block three processes use as much. The
servo has SCHED_FIFO in both where that is permitted (figure `fifo`). Fisher's exact test (Fisher
1935), one-sided, judges whether the rate of late ticks under attack exceeds that of the control.

Figures: late ticks of each, their number, p, and the smallest share of late ticks under attack that
differs from the control's at p < JUDGED_P. A smaller difference is not detectable.
"""

import resource
import subprocess
import sys
import time
from dataclasses import replace
from typing import NamedTuple

from benchmarks.late import fisher_p
from support.attacks.live import usage
from support.attacks.rows import Losses, Outcome
from support.attacks.stage import Stage, shared
from support.tree import TESTS

BLOCK_S = 5
JUDGED_P = 0.01
ATTACKERS = ("floods", "subscriptions", "crowd")
WITHOUT_END = 1_000_000_000
COMMAND = [sys.executable, "-m", "support.attacks.peers"]


class Block(NamedTuple):
    """The counts of a block."""

    late: int
    ticks: int
    cpu_s: float  # of its processes and the gateway


def attack(times: int, seed: int) -> Outcome:
    """`times` seconds under attack, and as many under the control. Judged where the stage is not
    shared with tests: those assert no time.
    """
    if shared:
        return replace(judged(*_blocks(shared[0], times, seed)), tried=times, lost=0)
    with Stage() as stage:
        outcome = judged(*_blocks(stage, times, seed))
        granted = stage.daemon.client.status().servo["realtime"]["fifo"]["granted"]
        outcome.figures["fifo"] = float(granted)
        return replace(outcome, tried=times)


def judged(attacked: Block, control: Block) -> Outcome:
    """The verdict."""
    losses = Losses()
    p = fisher_p(attacked.late, attacked.ticks, control.late, control.ticks)
    if p < JUDGED_P:
        losses.add(f"{attacked.late} late ticks, {control.late} of the control, p = {p:.2g}")
    return losses.outcome(
        attacked.ticks,
        ticks=float(attacked.ticks),
        late=float(attacked.late),
        control_late=float(control.late),
        control_ticks=float(control.ticks),
        p=p,
        detectable_percent=100.0 * detectable(attacked.ticks, control) / max(1, attacked.ticks),
        cpu_s=attacked.cpu_s,
        control_cpu_s=control.cpu_s,
    )


def detectable(ticks: int, control: Block) -> int:
    """Return the smallest number of late ticks of `ticks` that the test distinguishes from the
    control.
    """
    low = 0
    high = max(1, ticks)
    while low < high:
        middle = (low + high) // 2
        if fisher_p(middle, ticks, control.late, control.ticks) < JUDGED_P:
            high = middle
        else:
            low = middle + 1
    return low


def _blocks(stage: Stage, times: int, seed: int) -> tuple[Block, Block]:
    stage.daemon.to_force()
    sums = [Block(0, 0, 0.0), Block(0, 0, 0.0)]
    for number, begin in enumerate(range(0, times, BLOCK_S)):
        seconds = min(BLOCK_S, times - begin)
        kinds = [[name, str(WITHOUT_END)] for name in ATTACKERS]
        found = [_block(stage, seconds, kinds, seed + number)]
        permille = round(1000.0 * found[0].cpu_s / seconds / len(ATTACKERS))
        kinds = [["burn", str(permille)]] * len(ATTACKERS)
        found.append(_block(stage, seconds, kinds, seed + number))
        sums = [Block(*map(sum, zip(*pair, strict=True))) for pair in zip(sums, found, strict=True)]
    return sums[0], sums[1]


def _block(stage: Stage, seconds: int, kinds: list[list[str]], seed: int) -> Block:
    watch = stage.watch
    gateway = stage.daemon.processes()["gateway"]
    folder = str(stage.daemon.folder)
    spent_s = -usage(gateway).cpu_s - _children_s()
    running = [
        subprocess.Popen(
            [*COMMAND, name, folder, pieces, str(seed)], cwd=TESTS, stdout=subprocess.DEVNULL
        )
        for name, pieces in kinds
    ]
    time.sleep(0.3)  # they have begun
    before = watch.late, watch.ticks
    time.sleep(seconds)
    block = watch.late - before[0], watch.ticks - before[1]
    for one in running:
        one.terminate()
        one.wait()
    return Block(*block, spent_s + usage(gateway).cpu_s + _children_s())


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
