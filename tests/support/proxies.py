"""A hand on a servo in the air whose spring has a proxy: a client moves it, tick by tick."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hapticd.core.environment import Environment, WorkspaceParams
from hapticd.core.params import SafetyParams, ServoParams
from hapticd.mailbox.layout import Command, Result, Value
from support.flight import masked
from support.models import servo_params
from support.pump import HeldFlight

OWNER = 9
RANGE_M = 0.02
RATE_HZ = 1000.0


def with_range(stiffness: float = 200.0, safety: SafetyParams | None = None) -> ServoParams:
    """A servo with that spring, B = 1 N s/m and a workspace of +-20 mm without end springs."""
    workspace = WorkspaceParams(-RANGE_M, RANGE_M)
    environment = Environment(stiffness, 1.0, workspace=workspace)
    return servo_params(environment=environment, safety=safety or SafetyParams())


class ProxyFlight(HeldFlight):
    """Enabled, with the lease of the environment held by OWNER; the hand is a mass."""

    def __init__(
        self, params: ServoParams, mass_kg: float = 1.0, damping_ns_per_m: float = 0.0
    ) -> None:
        super().__init__(params, mass_kg, damping_ns_per_m)
        self.lease(OWNER)
        assert self.do(Command.ENABLE) is Result.APPLIED
        self.fly(502)

    def lease(self, actor: int) -> None:
        """Give the lease of the environment to `actor`; 0: to none."""
        self.do(Command.SET, {Value.LEASE_CONTROL: float(actor)})

    def aim(self, target_m: float, actor: int = OWNER) -> Any:
        """Run a tick with a position of the law."""
        values = masked({Value.PROXY: target_m})
        return self._one(((1, int(Command.PROXY), actor, 0, values),))

    def follow(self, law: Callable[["ProxyFlight"], float], ticks: int, every: int = 1) -> None:
        """Run `ticks` with a law that moves the proxy in each `every`-th tick."""
        for tick in range(ticks):
            self.aim(law(self)) if tick % every == 0 else self.fly()

    @property
    def proxy_m(self) -> float:
        """As the record has it."""
        return float(self.blob["proxy_m"])

    @property
    def energy_j(self) -> float:
        """Of the hand, and of the spring on which it hangs."""
        stiffness = self.blob["gain"] * self.blob["stiffness_n_per_m"]
        bent = self.position_m - self.proxy_m
        return 0.5 * (self._mass_kg * self.velocity_m_per_s**2 + stiffness * bent**2)


def generous(**changes: Any) -> SafetyParams:
    """Settings without a limit of the energy."""
    return replace(SafetyParams(proxy_energy_j=1e6, proxy_stored_j=1e6), **changes)
