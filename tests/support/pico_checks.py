"""Checks of the shipped image of the Pico, one function per subject. Each raises AssertionError on
a failure. tests/acceptance/pico runs them on the shipped image, and on images with a defect. Each
defect has to fail one of them.
"""

from collections.abc import Callable

from hapticd.core.errors import LinkError
from hapticd.usb import codec
from hapticd.usb.frames import HELLO_BYTES, Capability, Request, StatusBit
from support.pico_backend import CONFIGURATION, DEVICE
from support.pico_chip import B1, OPEN, PicoChip, Verb
from support.pico_host import TICK_NS, PicoHost
from support.pico_plant import Rig

USB_VENDOR, USB_PRODUCT = 0x1209, 0x0001
OUT = 0x01  # the endpoint
TORQUE_N = 1.0
DAMPING = 2.0  # N s/m
TRIM = 1000  # counts of the resistance
STOP_BUSY_US = 60.0
STOP_US = 10.0  # from the stop's pin to the amplifier's; the chip adds its interrupt entry
WATCHDOG_MS = 6.0  # of the hardware: 5 ms plus the interval since the last feed
# steps of a part, in counts of the wire; the first has damping on its upper half
TORQUE_STEPS = {"dac8563": 1, "mcp4922": 16}
DAMPING_STEPS = {"dac8563": 2, "mcp4922": 16, "dac8812": 1}
RESET_MS = 5.0  # from the reset of the processor until the firmware has written to its DACs
LIFE = 0x100


def check_power_up(chip: PicoChip, rig: Rig) -> None:
    """Without a host the board attaches to the bus, makes no torque, and stays so."""
    assert rig.plug(), chip.complaints()
    rig.advance(rig.now_ns + 50e6)
    told = chip.told()
    assert told["resets"] == 0
    assert chip.state.amplifier == 0
    assert (chip.state.torque, chip.state.damping, chip.state.resistance) == (0.0, 0.0, 0.0)
    assert told["complaints"] == []


def check_descriptors(host: PicoHost) -> None:
    """Descriptors agree with firmware_iface/PROTOCOL.md; the serial number is that of HELLO."""
    backend = host.backend
    device = backend.get_device_descriptor(None)
    assert (device.idVendor, device.idProduct) == (USB_VENDOR, USB_PRODUCT)
    assert len(backend._raw[DEVICE]) == 18
    assert len(backend._raw[CONFIGURATION]) == 32
    ends = [backend.get_endpoint_descriptor(None, index, 0, 0, 0) for index in range(2)]
    found = [(end.bEndpointAddress, end.bmAttributes, end.wMaxPacketSize) for end in ends]
    assert found == [(0x01, 2, 64), (0x81, 2, 64)]
    told = codec.greet(host.link.request(Request.HELLO, HELLO_BYTES))
    assert told.serial == host.params.serial


def check_exchange(host: PicoHost) -> None:
    """Each frame is answered, in order, by the frame that it requested."""
    first = host.tick(enable=False)
    for number in range(1, 30):
        frame = host.tick(0.1, DAMPING)
        assert (frame.seq, frame.echo) == (first.seq + number, number)
        assert frame.status == StatusBit.ENABLED | StatusBit.AMPLIFIER_READY


def check_replaced(host: PicoHost) -> None:
    """An unread frame is replaced by the next one, or kept where the silicon cannot replace it. The
    frames after it arrive in order.
    """
    host.tick(enable=False)
    oldest = host.seq
    for _ in range(4):
        host.write(host.out())
        host.pause(1.0)
    kept = oldest if host.chip.wiring.chip_id == B1 else host.seq - 1
    assert host.read().echo == kept
    following = host.tick()
    assert (following.echo, following.seq) == (host.seq - 1, host.seq - 1)


def check_race(host: PicoHost) -> None:
    """A host that reads during a replacement gets whole frames, each only once."""
    host.tick(enable=False)
    seqs = []
    for step in range(40):
        host.write(host.out())
        host.pause(1.0)
        host.write(host.out())
        host.pause(0.85 + step * 0.003)  # about its latch
        seqs.append(host.read().seq)
        host.pause(1.0)
        if step % 2 or host.chip.wiring.chip_id == B1:
            host.tick()
            host.pause(1.0)
    assert seqs == sorted(set(seqs))


def check_burst(host: PicoHost) -> None:
    """Packets that come one after the other, each while the last one is worked on: a frame, a
    single byte, a frame.
    """
    host.tick(enable=False)
    first, last = (bytes(codec.encode_out(host.out())) for _ in range(2))
    numbers = [host.chip.submit(OUT, 0, packet) for packet in (first, b"\0", last)]
    for number in numbers:
        assert host.rig.wait(number, TICK_NS).status == 0
    host.backend.lead()
    host.pause(1.0)
    frame = host.read()
    assert frame.echo == host.seq - 1
    assert frame.seq == host.seq - (2 if host.chip.wiring.chip_id == B1 else 1)
    assert frame.status & StatusBit.BAD_FRAME
    assert not frame.status & StatusBit.SEQ_GAP


def check_outputs(host: PicoHost) -> None:
    """The DACs output torque and damping, to the rounding, with either sign."""
    host.start()
    for torque_n in (TORQUE_N, -TORQUE_N, 0.0, 7.99, -7.99):
        host.tick(torque_n, DAMPING)
        state = host.chip.state
        wiring = host.chip.wiring
        asked = round(torque_n / host.params.force_n_per_count)
        assert abs(state.torque - asked) <= TORQUE_STEPS[wiring.dac] / 2
        damping = round(DAMPING / host.params.active_damping_ns_per_m_per_count)
        assert abs(state.damping - damping) <= DAMPING_STEPS[wiring.damping_dac] / 2
        assert state.amplifier == 1


def check_trim(host: PicoHost) -> None:
    """The resistance trim acts without ENABLE, never below 0; the protocol's watchdog keeps it."""
    told = codec.greet(host.link.request(Request.HELLO, HELLO_BYTES))
    assert told.capabilities & Capability.RESISTANCE
    for count in (1, 32767, -1, 20000):
        host.write(host.out(enable=False, trim=count))
        host.read()
        assert host.chip.state.resistance == max(0, count)
    host.pause(host.params.watchdog_ms + 2.0)
    assert host.chip.state.resistance == 20000


def check_encoder(host: PicoHost) -> None:
    """A positive force counts up, to the very count of the plant."""
    host.start(TORQUE_N, 0.0)
    host.tick()
    host.pause(1.0)
    frame = host.tick()
    assert frame.encoder > 100
    assert abs(frame.encoder - host.chip.state.encoder) <= 400  # it moves on while this is read
    assert not frame.status & StatusBit.ENCODER_FAULT


def check_skip(host: PicoHost) -> None:
    """A step by two states is ENCODER_FAULT, which disables the torque."""
    host.start()
    assert host.chip.state.amplifier == 1
    host.chip.tell(Verb.SKIP)
    frame = host.tick()
    assert frame.status & StatusBit.ENCODER_FAULT
    assert host.chip.state.amplifier == 0
    host.link.request(Request.CLEAR_FAULT)
    assert not host.tick(enable=False).status & StatusBit.ENCODER_FAULT


def _amplifier_off_ns(host: PicoHost) -> float:
    """Return when the amplifier's pin went low, among the changes since the last call."""
    changes = host.chip.told()["changes"]
    off = [at for at, name, value in changes if name == "amplifier" and value == 0]
    assert off, "the amplifier stays enabled"
    return float(off[0])


def check_stop(host: PicoHost) -> None:
    """Pressed, or its wire broken: the amplifier is off at once, and stays off when released."""
    for level in (0, OPEN):
        host.tick(enable=False)
        host.start(TORQUE_N)
        host.chip.told()
        pressed_ns = host.rig.now_ns
        host.chip.drive("stop", level)
        host.rig.advance(pressed_ns + 200e3)
        assert _amplifier_off_ns(host) - pressed_ns < STOP_US * 1e3
        assert host.tick(TORQUE_N).status & StatusBit.EMERGENCY_STOP
        host.chip.drive("stop", 1)
        host.rig.advance(host.rig.now_ns + 200e3)
        assert host.chip.state.amplifier == 0


def check_stop_busy(host: PicoHost) -> None:
    """Pressed at any instant while frames come: after the one that is being worked on at most."""
    for step in range(12):
        host.tick(enable=False)
        host.start(TORQUE_N)
        host.chip.told()
        begun_ns = host.rig.now_ns
        host.chip.submit(OUT, 0, bytes(codec.encode_out(host.out(TORQUE_N))))
        host.rig.advance(begun_ns + 20e3 + step * 8e3)
        pressed_ns = host.rig.now_ns
        host.chip.drive("stop", 0)
        host.rig.advance(pressed_ns + 200e3)
        assert _amplifier_off_ns(host) - pressed_ns < STOP_BUSY_US * 1e3
        host.chip.drive("stop", 1)
        host.backend.lead()
        host.pause(1.0)
        host.read()


def check_ready(host: PicoHost) -> None:
    """An amplifier that is not ready, or has a broken wire, gets no torque."""
    for level in (0, OPEN):
        host.chip.drive("ready", 1)
        host.tick(enable=False)
        host.start(TORQUE_N)
        host.chip.drive("ready", level)
        frame = host.tick(TORQUE_N)
        assert not frame.status & (StatusBit.AMPLIFIER_READY | StatusBit.ENABLED)
        assert host.chip.state.amplifier == 0


def check_events(host: PicoHost) -> None:
    """Codes at the event pins arrive with the board's time, from the first pin to the last."""
    before = host.tick()
    for bit, code in ((0, 0x01), (7, 0x81)):
        host.chip.drive(f"event{bit}", 1)
        host.rig.advance(host.rig.now_ns + 300e3)
        seen = [host.tick() for _ in range(4)]
        assert [frame.event_code for frame in seen if frame.event_seq != before.event_seq][
            -1
        ] == code
        first = next(frame for frame in seen if frame.event_seq != before.event_seq)
        assert 0 < first.event_age_us < 2500
        before = seen[-1]


def check_silence(host: PicoHost) -> None:
    """A silent host: no torque after the watchdog time, damping held 2 s and released in 0.5 s."""
    host.start(TORQUE_N, DAMPING)
    host.chip.told()
    begun_ns = host.rig.now_ns
    host.pause(host.params.watchdog_ms + 2.0)
    assert (_amplifier_off_ns(host) - begun_ns) / 1e6 < host.params.watchdog_ms + 0.5
    held = host.chip.state.damping
    host.pause(1950.0)
    assert host.chip.state.damping == held > 0.0
    host.pause(300.0)
    assert 0.0 < host.chip.state.damping < held
    host.pause(300.0)
    assert host.chip.state.damping == 0.0
    assert host.tick(TORQUE_N).status & StatusBit.WATCHDOG
    assert not host.start(TORQUE_N).status & StatusBit.WATCHDOG


def check_reset(host: PicoHost) -> None:
    """In a reset of the processor the DACs keep their outputs: only the amplifier's enable removes
    the force. The restarted firmware writes no output.
    """
    host.start(TORQUE_N, DAMPING)
    host.write(host.out(TORQUE_N, DAMPING, trim=TRIM))
    host.read()
    host.chip.told()
    host.chip.tell(Verb.HANG)
    host.rig.advance(host.rig.now_ns + 30e6)
    changes = host.chip.told()["changes"]
    (off_ns,) = [at for at, name, value in changes if name == "amplifier"]
    zeroed = {name: at for at, name, value in changes if name != "amplifier" and value == 0}
    assert set(zeroed) == {"torque", "damping", *_trim(host)}
    assert all(0 < at - off_ns < RESET_MS * 1e6 for at in zeroed.values())


def _trim(host: PicoHost) -> set[str]:
    """The output that only a part with a channel for it has."""
    return {"resistance"} if host.chip.wiring.damping_dac == "dac8812" else set()


def _check_dies(host: PicoHost, how: Verb) -> None:
    life = host.start(TORQUE_N, DAMPING).life
    host.chip.told()
    begun_ns = host.rig.now_ns
    host.chip.tell(how)
    host.rig.advance(begun_ns + 30e6)
    assert (_amplifier_off_ns(host) - begun_ns) / 1e6 < WATCHDOG_MS
    assert host.chip.told()["resets"] == 1
    try:
        host.tick(TORQUE_N)
        raise AssertionError("a board that has left the bus answers")
    except LinkError:
        pass
    host.plug_again()
    frame = host.tick(enable=False)
    assert frame.life == (life + 1) % LIFE
    assert host.chip.state.amplifier == 0


def check_hang(host: PicoHost) -> None:
    """The processor stops: the hardware watchdog ends the torque and restarts it."""
    _check_dies(host, Verb.HANG)


def check_deaf(host: PicoHost) -> None:
    """The processor runs without interrupts: only the service feeds the watchdog."""
    _check_dies(host, Verb.DEAF)


# about unread frames in the board: with transfers in flight one IN is always pending
IN_TURN = ("replaced", "race", "burst", "stop_busy")
CHECKS: dict[str, Callable[[PicoHost], None]] = {
    "descriptors": check_descriptors,
    "exchange": check_exchange,
    "replaced": check_replaced,
    "race": check_race,
    "burst": check_burst,
    "outputs": check_outputs,
    "trim": check_trim,
    "encoder": check_encoder,
    "skip": check_skip,
    "stop": check_stop,
    "stop_busy": check_stop_busy,
    "ready": check_ready,
    "events": check_events,
    "silence": check_silence,
    "reset": check_reset,
    "hang": check_hang,
    "deaf": check_deaf,
}
