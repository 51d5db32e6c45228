"""The bookkeeping of `make bench`: judging, merging, the table, and yardsticks that do the work
they claim. Nothing is timed.
"""

import pytest

from benchmarks.engine_c import CReference as CScene
from benchmarks.engine_c import check_same
from benchmarks.engine_scene import Lanes, model
from benchmarks.worker import BenchError
from hapticd.model.compose import compose
from hapticd.settings.scene import load_scene


@pytest.mark.parametrize(("scene", "substeps"), [(None, 1), ("fig7", 1), ("fig7", 4)])
def test_c_of_a_scene_moves_as_the_engine(scene: str | None, substeps: int) -> None:
    device = model() if scene is None else compose(load_scene(scene))
    ours = Lanes(
        device, "f64", 64, substeps=substeps, level_ns_per_m=0.0 if scene is None else 1.74
    )
    theirs = CScene(ours, "f64", 8)
    check_same(ours, theirs, "f64")
    theirs.scene[1] *= 1.01  # how a velocity moves a position: row 0 of the map
    with pytest.raises(
        BenchError, match=r"engine_reference\.c moves otherwise than the engine, by .*; correct it"
    ):
        check_same(
            Lanes(
                device, "f64", 64, substeps=substeps, level_ns_per_m=0.0 if scene is None else 1.74
            ),
            theirs,
            "f64",
        )
