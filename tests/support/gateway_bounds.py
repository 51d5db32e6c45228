"""The load of clients costs them service, never the servo its heartbeat: counted, not timed."""

from support.gateway_rig import GatewayRig


def command(rig: GatewayRig) -> str:
    return str(rig.gateway.endpoints["command"])
