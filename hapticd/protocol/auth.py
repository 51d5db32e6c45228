"""Who may connect from where.

Commands are taken on a socket file in the runtime folder: the file system says who. Telemetry is
offered there and on the loopback; on any other address only with CURVE keys (`keys`), by the relay
(`gateway.relay`), or when the configuration says `allow_insecure`, and then with a warning.
"""

import ipaddress

from hapticd.core.errors import ConfigError
from hapticd.core.params import GatewayParams

__all__ = ["LEAVE_NEEDED", "in_the_clear", "needs_keys", "without_leave"]


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


def in_the_clear(params: GatewayParams) -> bool:
    """Whether telemetry leaves the machine without keys or encryption.

    ConfigError if that would be without leave.
    """
    if without_leave(params):
        raise ConfigError(f"gateway.tcp_host = {params.tcp_host!r}: {LEAVE_NEEDED}")
    return not is_loopback(params.tcp_host) and params.curve_keys is None


def needs_keys(params: GatewayParams) -> bool:
    """Whether TCP is for those with a key."""
    return params.curve_keys is not None and not is_loopback(params.tcp_host)
