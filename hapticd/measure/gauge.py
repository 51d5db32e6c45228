"""How wrong a setting of the engine is, and what it costs: what the two gauges (`gauge_noise`, `gauge_trace`) have in common.

A reading has two errors. `step` is what the setting does to the answer for the same perturbation: the sub-step's, the
precision's, a left-out effect's. `total` is the error of one trial that is made with it, chance or resolution included; of
two settings with the same total the cheaper one is the better.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

from hapticd.analysis.spa import DEFAULT_LAG
from hapticd.measure.scenes import SUBSTEPS
from hapticd.measure.stopwatch import Stopwatch
from hapticd.plant.scene import Scene
from hapticd.sim.engine.shape import LANES

GROUP = LANES["f64"]


@dataclass(frozen=True, slots=True)
class Setting:
    """How a scene is simulated and looked at; the defaults are those of the procedures. `without`: effects that are left out."""

    seconds: float
    substeps: int = SUBSTEPS
    dtype: str = "f64"
    lag: int = DEFAULT_LAG
    without: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Reading:
    """Errors in the gauge's unit. nan: does not apply."""

    step: float
    total: float


class Gauge(ABC):
    """`exact` is how finely the reference is simulated. After `prepare` it may be read."""

    unit: str
    quantity: str

    def __init__(self, scene: Scene, source: object, seconds: float, exact: Setting, now_ns: Stopwatch) -> None:
        self.scene, self.source, self.seconds, self.exact, self.now_ns = scene, source, seconds, exact, now_ns

    @abstractmethod
    def prepare(self) -> None:
        """Make the reference."""

    @property
    @abstractmethod
    def reference(self) -> str:
        """What errors are measured against, and how well that is known."""

    @abstractmethod
    def read(self, setting: Setting) -> Reading:
        """A trial in a full group. With `without`: against the whole scene as it was read with that setting, else the reference."""

    @abstractmethod
    def cost(self, setting: Setting) -> float:
        """Seconds for one trial of a full group, timed once; the setting has been read before."""

    @abstractmethod
    def alone(self, setting: Setting) -> float:
        """Seconds for a single trial that is asked alone."""

    @abstractmethod
    def lockstep(self, seconds: float) -> tuple[Reading, float]:
        """One trial with the whole product, and what it took. ConfigError or AnalysisError where the scene cannot be flown."""
