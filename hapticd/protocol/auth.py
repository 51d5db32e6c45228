"""Access to the gateway, by address.

Commands are accepted only on a socket file in the runtime folder, with the permissions of the file
system. Telemetry is offered there and on the loopback. On other addresses it needs CURVE keys
(`keys`) and the relay (`gateway.relay`), or `allow_insecure` in the configuration, with a warning.
"""

import ipaddress

from hapticd.core.errors import ConfigError
from hapticd.core.params import GatewayParams

__all__ = ["LEAVE_NEEDED", "in_the_clear", "needs_keys", "without_leave"]


def is_loopback(host: str) -> bool:
    """Return whether `host` is an address of this machine alone.

    Of names, only localhost counts.
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
    """Return whether telemetry would leave the machine unencrypted without permission."""
    return not (
        is_loopback(params.tcp_host) or params.curve_keys is not None or params.allow_insecure
    )


def in_the_clear(params: GatewayParams) -> bool:
    """Return whether telemetry leaves the machine without keys or encryption.

    ConfigError if that is not permitted.
    """
    if without_leave(params):
        raise ConfigError(f"gateway.tcp_host = {params.tcp_host!r}: {LEAVE_NEEDED}")
    return not is_loopback(params.tcp_host) and params.curve_keys is None


def needs_keys(params: GatewayParams) -> bool:
    """Return whether TCP requires a key."""
    return params.curve_keys is not None and not is_loopback(params.tcp_host)
