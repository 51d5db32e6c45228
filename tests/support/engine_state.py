"""Looking at the engine's state array after a batch."""

import numpy as np

from hapticd.zwidth.engine import batch
from hapticd.zwidth.engine.batch import simulate
from hapticd.zwidth.engine.job import Group


def final(monkeypatch, *arguments, **options):
    """(rows of the first group after the batch by name, the result) of `simulate(*arguments,
    **options)`.
    """
    made = []

    class Watched(Group):
        def __init__(self, *parts):
            super().__init__(*parts)
            made.append(self)

    monkeypatch.setattr(batch, "Group", Watched)
    result = simulate(*arguments, **options)
    return {name: np.array(row[: made[0].count]) for name, row in made[0].rows.items()}, result
