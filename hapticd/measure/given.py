"""What a trial renders, of what was typed, the scene and the record: one rule for all of them.

Of K, B and M what is not given is that of the scene that was named, else 0: nobody who asks for
K = 500 N/m alone asks for the B and M of a scene that was not named. With none of the three given
the environment is that of the record, else of the scene as it is, else 0. The electrical damping is
a property of the device's drive: it is the record's, else the scene's, unless it is given.
"""

from hapticd.errors import AnalysisError
from hapticd.measure import scenes
from hapticd.measure.store import Recorded, Rendered
from hapticd.plant.scene import Scene

NAMES = (("K", "N/m"), ("B", "N s/m"), ("M", "kg"))
Typed = tuple[float | None, float | None, float | None]  # K [N/m], B [N s/m], M [kg]
SAME = 1e-6  # relative


def given(
    typed: Typed, damping_ns_per_m: float | None, scene: Scene | None, named: bool, recorded: Recorded | None = None
) -> Rendered:
    """What is rendered; `named`: the user named `scene`. AnalysisError where a record was made in something else than what was
    typed.
    """
    told = recorded.rendered if recorded else None
    if told is not None:
        _agrees(recorded.origin if recorded else "", typed, damping_ns_per_m, told)
        return told
    known = Rendered(scenes.point(scene), scenes.level(scene)) if scene else Rendered()
    others = known.environment if named or typed == (None, None, None) else (0.0, 0.0, 0.0)
    stiffness, damping, mass = (other if own is None else own for own, other in zip(typed, others, strict=True))
    level = known.damping_ns_per_m if damping_ns_per_m is None else damping_ns_per_m
    return Rendered((stiffness, damping, mass), level)


def _agrees(origin: str, typed: Typed, damping_ns_per_m: float | None, told: Rendered) -> None:
    every = zip(
        (*NAMES, ("added damping", "N s/m")), (*typed, damping_ns_per_m), (*told.environment, told.damping_ns_per_m), strict=True
    )
    for (name, unit), said, known in every:
        if said is not None and abs(said - known) > SAME * abs(known):
            raise AnalysisError(f"{origin}: recorded in {name} = {known:g} {unit}, not {said:g} {unit}: leave that out")
