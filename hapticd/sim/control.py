"""What the board answers on endpoint 0: the hello reply and its string descriptors, one table
of bytes.
"""

from hapticd.params import BoardParams
from hapticd.wire import codec, frames
from hapticd.wire.frames import Capability, Hello, Request

VENDOR_IN = 0xC0
VENDOR_OUT = 0x40
STANDARD_IN = 0x80
GET_DESCRIPTOR = 0x06
STRING = 0x03
ENGLISH_US = 0x0409
# string indices
MANUFACTURER = 1
PRODUCT = 2
SERIAL = 3
FIRMWARE_VERSION = 0x0100
CAPABILITIES = (
    Capability.PROBE | Capability.INTERVAL_MEAN | Capability.TEMPERATURE | Capability.SIMULATED
)

Replies = dict[tuple[int, int, int], bytes]  # by bmRequestType, bRequest, wValue


def hello(params: BoardParams) -> Hello:
    """The board's own description: nominal full scales are value per count times full count."""
    return Hello(
        protocol_hash=frames.PROTOCOL_HASH,
        firmware_version=FIRMWARE_VERSION,
        axis_count=1,
        capabilities=CAPABILITIES.value,
        watchdog_ms=round(params.watchdog_ms),
        serial=params.serial,
        force_full_scale_n=params.force_n_per_count * codec.I16_HIGHEST,
        damping_full_scale_ns_per_m=params.damping_ns_per_m_per_count * codec.U16_HIGHEST,
        probe_torque_full_scale_n=params.probe_torque_n_per_count * codec.I16_HIGHEST,
        probe_velocity_full_scale_m_s=params.probe_velocity_m_per_s_per_count * codec.I16_HIGHEST,
        current_full_scale_a=params.current_a_per_count * codec.I16_HIGHEST,
        voltage_full_scale_v=params.voltage_v_per_count * codec.I16_HIGHEST,
        position_m_per_count=params.position_m_per_count,
        force_limit_n=params.force_limit_n,
    )


def string_descriptor(text: str) -> bytes:
    """USB string descriptor: length, type, UTF-16-LE."""
    body = text.encode("utf-16-le")
    return bytes((2 + len(body), STRING)) + body


def control_replies(params: BoardParams) -> Replies:
    """Everything that may be read from endpoint 0; what is not in it stalls."""
    strings = {MANUFACTURER: "hapticd", PRODUCT: "analog board (simulated)", SERIAL: params.serial}
    replies = {
        (STANDARD_IN, GET_DESCRIPTOR, STRING << 8 | i): string_descriptor(text)
        for i, text in strings.items()
    }
    replies[STANDARD_IN, GET_DESCRIPTOR, STRING << 8] = bytes((4, STRING)) + ENGLISH_US.to_bytes(
        2, "little"
    )
    replies[VENDOR_IN, Request.HELLO.value, 0] = codec.encode_hello(hello(params))
    return replies
