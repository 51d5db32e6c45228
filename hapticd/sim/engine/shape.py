"""What is compiled in: everything about a scene that decides which instructions its kernel has, and
no number.

Two scenes with the same shape share a kernel; their numbers are its arguments. An effect that is
absent leaves no trace here, so it costs nothing. `shaping` reads it off a model.
"""

from dataclasses import dataclass

LANES = {"f32": 64, "f64": 32}


@dataclass(frozen=True, slots=True)
class Term:
    """A state in a sum, with a coefficient of its own or with exactly 1."""

    state: int
    one: bool


@dataclass(frozen=True, slots=True)
class Shape:
    """See the module. Tuples over states unless said otherwise."""

    dtype: str  # "f32" | "f64"
    lanes: int
    samples: int  # 4 kHz samples in a tick
    substeps: int  # in a sample
    keeps: tuple[bool, ...]  # this state's own coefficient is 1 and no other state depends on it
    feeds: tuple[tuple[int, ...], ...]  # states with a coefficient in this state's sum
    command: tuple[bool, ...]
    torque: tuple[bool, ...]
    drift: tuple[bool, ...]  # a constant is added at every sub-step
    contacts: tuple[tuple[int, int, tuple[bool, ...]], ...]  # velocity and position state, column
    origin: int  # position state of the rotor
    distances: tuple[int, ...]  # position states that count from the rotor's, see `coordinates`
    rotor_laws: tuple[str, ...]  # forces on the rotor that are not linear
    rotor: tuple[int, int, tuple[bool, ...]] | None  # position, velocity, column of these
    stops: tuple[int, int] | None  # position, velocity
    sample_step: int  # sub-step at whose start, or in which, the encoder is read
    sample_inside: bool
    sample: tuple[Term, ...]
    travel: tuple[Term, ...]
    impulse: tuple[Term, ...] | None
    waits: int  # whole ticks that a command waits
    encoder_quantum: bool = False
    force_quantum: bool = False
    limit: bool = False
    wall: bool = False
    ends: bool = False  # the law's soft ends
    heat: tuple[tuple[Term, ...], bool] | None = (
        None  # the motor force, and whether the command is in it
    )
    noise: tuple[bool, ...] | None = None  # the column of the velocity estimate's noise
    renders: bool = True  # the law is needed
    own_torque: bool = False  # a record for every trial
    ticks: bool = False  # keep position and force of every tick

    @property
    def per_lane(self) -> bool:
        """Whether coefficients differ between trials: where windings heat up."""
        return self.heat is not None

    @property
    def states(self) -> int:
        """How many."""
        return len(self.keeps)

    def fed(self, state: int) -> bool:
        """Whether an input moves this state within a sub-step."""
        noise = self.noise is not None and self.noise[state]
        return self.command[state] or self.torque[state] or self.drift[state] or noise

    @property
    def gaining(self) -> int | None:
        """The state that is the recorded travel itself and only gains: its gains are the
        record, without a difference.
        """
        first = self.travel[0]
        return (
            first.state if len(self.travel) == 1 and first.one and self.keeps[first.state] else None
        )

    @property
    def steps(self) -> int:
        """Sub-steps in a tick."""
        return self.samples * self.substeps

    @property
    def width(self) -> int:
        """Values that a tick leaves for each lane: velocities, torques if filtered, force,
        position if kept.
        """
        return self.samples * (1 if self.impulse is None else 2) + (2 if self.ticks else 1)
