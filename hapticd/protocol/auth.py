"""Who may connect from where.

Commands are taken on a socket file in the runtime folder: the file system says who. Telemetry is
offered there and on the loopback; on any other address only with CURVE keys (`keys`), by the relay
(`gateway.relay`), or when the configuration says `allow_insecure`, and then with a warning.
"""

import ipaddress

from hapticd.core.errors import ConfigError
from hapticd.core.params import GatewayParams

__all__ = ["LEAVE_NEEDED", "needs_keys", "warning", "without_leave"]


def is_loopback(host: str) -> bool:
    """Whether `host` is an address of this machine alone.

    Names other than localhost are not trusted to be.
    """
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


LEAVE_NEEDED = (
    "beyond this machine telemetry needs keys; set gateway.curve_keys, or gateway.allow_insecure ="
    " true if everyone on that network may listen, or use 127.0.0.1"
)


def without_leave(params: GatewayParams) -> bool:
    """Whether telemetry would leave the machine in the clear, and nobody has allowed that."""
    return not (
        is_loopback(params.tcp_host) or params.curve_keys is not None or params.allow_insecure
    )


def warning(params: GatewayParams) -> str | None:
    """What to warn of, None if nothing.

    ConfigError if telemetry would leave the machine in the clear without leave.
    """
    if is_loopback(params.tcp_host) or params.curve_keys is not None:
        return None
    if without_leave(params):
        raise ConfigError(f"gateway.tcp_host = {params.tcp_host!r}: {LEAVE_NEEDED}")
    return (
        f"INSECURE: telemetry is offered on {params.tcp_host} to everyone, without keys or"
        " encryption; set gateway.curve_keys"
    )


def needs_keys(params: GatewayParams) -> bool:
    """Whether TCP is for those with a key."""
    return params.curve_keys is not None and not is_loopback(params.tcp_host)
