"""The simulated board behind USB/IP: the frames of the fake backend, the errors of a controller."""

import errno
import os
import resource
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from support.boards import ENABLE, LATCH_NS, TICK_NS, board_params, out_packet
from support.sim_usbip import DEADLINE_S
from support.usbip_client import DEVICE_BYTES, DEVICES, VENDOR_IN, Client, exactly

from hapticd.cli import sim
from hapticd.cli.app import main
from hapticd.core.units import NS_PER_MS, NS_PER_S, VirtualClock
from hapticd.model.params import BoardParams, InjectionParams
from hapticd.sim import usb_device
from hapticd.sim.board import BoardModel, make_board
from hapticd.sim.injection import with_injections
from hapticd.sim.usb_device import UsbDevice
from hapticd.sim.usbip import UsbipServer
from hapticd.usb import codec
from hapticd.usb.frames import HELLO_BYTES, Request, StatusBit

START_NS = 1000 * NS_PER_S
CLEAR_HALT = (0x02, 0x01, 0)


class Bench:
    """A server in a thread, on virtual time, and one host that has attached its board."""

    def __init__(self, *injections: InjectionParams, hello_s: float = 0.0, **traits: Any) -> None:
        params: BoardParams = board_params(injections=injections, **traits)
        self.clock = VirtualClock(START_NS)
        self.board = make_board(params)
        self.told: list[str] = []
        device = UsbDevice(with_injections(self.board, params), "bulk", hello_s)
        self.server = UsbipServer(device, self.clock, "127.0.0.1", 0, self.told.append)
        self.thread = threading.Thread(target=self.server.serve)
        self.thread.start()
        self.tick = 0
        self.client = Client(self.server.address)
        assert self.client.attach() == 0

    def another(self) -> Client:
        return Client(self.server.address)

    def out(self) -> int:
        """One OUT frame; the status of its transfer."""
        status = self.client.write(bytes(out_packet(self.tick & 0xFFFF, flags=ENABLE))).status
        self.tick += 1
        return status

    def ask(self, room: int = 64) -> int:
        """Begin to read an IN frame."""
        return self.client.submit(1, True, room=room)

    def pair(self) -> tuple[int, bytes]:
        """OUT and IN of one tick; status and bytes of the IN."""
        assert self.out() == 0
        self.ask()
        self.clock.time_ns += TICK_NS
        found = self.client.answer()
        return found.status, found.data

    def end(self) -> None:
        self.client.close()
        self.server.stop()
        self.thread.join(DEADLINE_S)
        assert not self.thread.is_alive()


@pytest.fixture
def make() -> Iterator[Callable[..., Bench]]:
    made: list[Bench] = []

    def bench(*injections: InjectionParams, **traits: Any) -> Bench:
        made.append(Bench(*injections, **traits))
        return made[-1]

    yield bench
    for one in made:
        one.end()


# --- enumeration ----------------------------------------------------------------------------------


def test_bytes_of_the_descriptors_are_those_of_the_specification() -> None:
    """USB 2.0, tables 9-8, 9-10, 9-12 and 9-13, byte for byte."""
    device = bytes.fromhex("12 01 00 02 ff 00 00 40 09 12 01 00 00 01 01 02 03 01")
    assert usb_device.device_bytes() == device
    head = bytes.fromhex("09 02 20 00 01 01 00 80 fa") + bytes.fromhex("09 04 00 00 02 ff 00 00 00")
    bulk = bytes.fromhex("07 05 01 02 40 00 00") + bytes.fromhex("07 05 81 02 40 00 00")
    assert usb_device.configuration_bytes("bulk") == head + bulk
    interrupt = bytes.fromhex("07 05 01 03 40 00 01") + bytes.fromhex("07 05 81 03 40 00 01")
    assert usb_device.configuration_bytes("interrupt") == head + interrupt


def test_host_enumerates_and_greets_the_board(make: Callable[..., Bench]) -> None:
    client = make().client
    assert client.control(0x80, 6, 0x0100, 0, 18).data == usb_device.device_bytes()
    assert client.control(0x80, 6, 0x0200, 0, 9).data == usb_device.configuration_bytes("bulk")[:9]
    assert client.control(0x80, 6, 0x0600, 0, 10).status == -errno.EPIPE  # full speed alone
    assert client.control(0x00, 9, 1, 0, 0).status == 0
    assert client.control(0x80, 8, 0, 0, 1).data == b"\x01"
    assert client.control(0x80, 6, 0x0303, 0x0409, 255).data[2:].decode("utf-16-le") == "SIM0001"
    hello = client.control(VENDOR_IN, Request.HELLO.value, 0, 0, HELLO_BYTES)
    assert codec.decode_hello(hello.data).serial == "SIM0001"
    assert client.control(VENDOR_IN, 0x7F, 0, 0, 8).status == -errno.EPIPE


def test_list_of_devices_is_the_board(make: Callable[..., Bench]) -> None:
    lister = make().another()
    lister.connection.sendall(DEVICES)
    assert exactly(lister.connection, 12) == struct.pack(">HHII", 0x0111, 5, 0, 1)
    told = exactly(lister.connection, DEVICE_BYTES)
    assert told[256:288].rstrip(b"\0") == b"1-1"
    assert struct.unpack_from(">3I3H", told, 288) == (1, 1, 2, 0x1209, 0x0001, 0x0100)
    assert exactly(lister.connection, 4) == b"\xff\0\0\0"
    lister.close()


def test_board_has_one_owner_and_comes_back_as_new(make: Callable[..., Bench]) -> None:
    bench = make()
    life = codec.decode_in(bench.pair()[1]).life
    second = bench.another()
    assert second.attach() == 2  # busy
    second.close()
    bench.client.close()
    while bench.server._importer is not None:
        pass
    bench.client = bench.another()
    assert bench.client.attach() == 0
    again = codec.decode_in(bench.pair()[1])
    assert (again.life, again.seq) == (life + 1, 0)


# --- frames ---------------------------------------------------------------------------------------


def test_frames_are_those_of_the_board_itself(make: Callable[..., Bench]) -> None:
    bench = make()
    board = BoardModel(board_params())
    board.power_up()  # an import is a plug
    for tick in range(50):
        status, data = bench.pair()
        now_ns = START_NS + tick * TICK_NS
        board.on_out(out_packet(tick, flags=ENABLE), now_ns)
        assert (status, data) == (0, board.poll_in(now_ns + LATCH_NS))


def test_read_waits_for_the_latch_and_can_be_taken_back(make: Callable[..., Bench]) -> None:
    bench = make()
    early = bench.ask()
    unlink = bench.client.unlink(early)
    assert bench.client.answer()[:3] == (4, unlink, -errno.ECONNRESET)
    status, data = bench.pair()
    assert (status, codec.decode_in(data).echo) == (0, 0)
    late = bench.client.unlink(bench.client.number)
    assert bench.client.answer()[:3] == (4, late, 0)  # it had ended before


def test_watchdog_of_the_board_runs_while_the_host_is_silent(make: Callable[..., Bench]) -> None:
    bench = make(watchdog_ms=100.0)
    bench.pair()
    for _ in range(20):
        bench.clock.time_ns += 10 * NS_PER_MS
        bench.client.control(0x80, 0, 0, 0, 2)
    status, data = bench.pair()
    assert status == 0
    assert codec.decode_in(data).status & StatusBit.WATCHDOG


# --- faults ---------------------------------------------------------------------------------------


def test_stalled_endpoint_halts_until_it_is_cleared(make: Callable[..., Bench]) -> None:
    bench = make(InjectionParams("stall_in", tick=0))
    assert bench.pair() == (-errno.EPIPE, b"")
    assert bench.client.control(0x82, 0, 0, 0x81, 2).data == b"\x01\0"
    bench.ask()
    assert bench.client.answer().status == -errno.EPIPE
    assert bench.client.control(*CLEAR_HALT, 0x81, 0).status == 0
    assert bench.pair()[0] == 0


def test_what_a_controller_reports(make: Callable[..., Bench]) -> None:
    bench = make(
        InjectionParams("babble", tick=0, value=3.0),
        InjectionParams("short_in", tick=1, value=20.0),
        InjectionParams("zero_length_in", tick=2),
        InjectionParams("io_error", tick=4),
        InjectionParams("stall_out", tick=5),
    )
    assert bench.pair() == (-errno.EOVERFLOW, b"")
    status, data = bench.pair()
    assert (status, len(data)) == (0, 20)
    assert [(status, len(data)) for status, data in (bench.pair(), bench.pair())] == [
        (0, 64),
        (0, 0),
    ]
    assert bench.out() == -errno.EPROTO
    assert bench.out() == -errno.EPIPE
    assert bench.client.control(*CLEAR_HALT, 0x01, 0).status == 0
    assert bench.out() == 0


def test_packet_that_is_longer_than_the_room_overflows(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.out()
    bench.ask(room=8)
    bench.clock.time_ns += TICK_NS
    assert bench.client.answer().status == -errno.EOVERFLOW


def test_firmware_that_hangs_takes_nothing_until_the_host_gives_up(
    make: Callable[..., Bench],
) -> None:
    bench = make(InjectionParams("hang", tick=0, value=3600.0))
    waits = bench.client.submit(1, False, bytes(out_packet(0)))
    taken_back = bench.client.unlink(waits)
    assert bench.client.answer()[:3] == (4, taken_back, -errno.ECONNRESET)


def test_slow_board_answers_no_request_before_its_time(make: Callable[..., Bench]) -> None:
    bench = make(hello_s=5.0)
    hello = (VENDOR_IN, Request.HELLO.value, 0, 0, HELLO_BYTES)
    setup = struct.pack("<BBHHH", *hello)
    waits = bench.client.submit(0, True, room=HELLO_BYTES, setup=setup)
    bench.client.unlink(waits)
    assert bench.client.answer().status == -errno.ECONNRESET
    bench.clock.time_ns += 5 * NS_PER_S
    assert bench.client.control(*hello).status == 0


def test_plug_is_pulled_under_a_transfer_and_stays_out(make: Callable[..., Bench]) -> None:
    bench = make(InjectionParams("unplug", tick=1, value=2.0))
    bench.pair()
    assert bench.out() == -errno.EPROTO
    with pytest.raises(EOFError):
        bench.client.answer()
    early = bench.another()
    assert early.attach() == 4  # no such device
    early.close()
    bench.clock.time_ns += 2 * NS_PER_S
    bench.client.close()
    bench.client = bench.another()
    assert bench.client.attach() == 0
    assert [line.partition(" ")[0] for line in bench.told] == ["attached", "detached", "attached"]


HOSTILE = [
    struct.pack(">HHI", 0x0111, 0x1234, 0),
    struct.pack(">HHI", 0x0111, 0x8003, 0) + b"9-9".ljust(32, b"\0"),
    bytes(200),
    b"\xff" * 4096,
]


@pytest.mark.parametrize("words", HOSTILE)
def test_nonsense_ends_a_connection_and_no_other(words: bytes, make: Callable[..., Bench]) -> None:
    bench = make()
    stranger = bench.another()
    stranger.connection.sendall(words)
    with pytest.raises((EOFError, ConnectionError)):
        exactly(stranger.connection, 4096)
    stranger.close()
    assert bench.pair()[0] == 0


@pytest.mark.parametrize("length", [-1, 2**31 - 1])
def test_transfer_of_a_foolish_length_ends_its_connection(
    length: int, make: Callable[..., Bench]
) -> None:
    bench = make()
    head = struct.pack(">5I", 1, 1, 0, 0, 1) + struct.pack(
        ">IiiiI8s", 0, length, 0, -1, 0, bytes(8)
    )
    bench.client.connection.sendall(head)
    with pytest.raises((EOFError, ConnectionError)):
        bench.client.answer()


def test_server_works_beyond_a_thousand_descriptors(make: Callable[..., Bench]) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2048), hard))
    occupied = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    try:
        bench = make()
        assert bench.out() == 0
    finally:
        for one in occupied:
            os.close(one)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_idle_connections_do_not_pile_up(make: Callable[..., Bench]) -> None:
    bench = make()
    idle = [bench.another() for _ in range(12)]
    for one in idle[:4]:
        with pytest.raises((EOFError, ConnectionError)):
            exactly(one.connection, 1)
    assert bench.pair()[0] == 0
    for one in idle:
        one.close()


# --- the verb -------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", ["nowhere", "1:2:x", "70000", "-1", "::1:3240", "[::1:3240"])
def test_address_that_is_none_is_a_usage_error(where: str) -> None:
    assert main(["sim-board", f"--usbip={where}"]) == 2


@pytest.mark.parametrize(
    ("text", "host", "family"),
    [("[::1]:3240", "::1", socket.AF_INET6), ("127.0.0.1:3240", "127.0.0.1", socket.AF_INET)],
)
def test_address_of_either_family_is_listened_at(
    make: Callable[..., Bench],
    text: str,
    host: str,
    family: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[object] = []
    listener = mock.Mock(getsockname=lambda: (host, 3240))
    assert sim.address(text) == (host, 3240)
    device = make().server._device
    monkeypatch.setattr(
        socket, "create_server", lambda *where, **how: asked.append((where, how)) or listener
    )
    server = UsbipServer(device, VirtualClock(0), host, 3240, print)
    assert server.address == text
    assert asked == [(((host, 3240),), {"family": family})]


def test_address_that_is_taken_is_named(
    make: Callable[..., Bench], capsys: pytest.CaptureFixture[str]
) -> None:
    taken = make().server.address
    assert main(["sim-board", "--usbip", taken]) == 78
    assert f"--usbip {taken}: Address already in use" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('device = "example-board"\n', "not a simulated device"),
        (
            "[simulation]\nboot_loader_s = 2.0\n",
            "simulation.boot_loader_s applies to the bus within",
        ),
    ],
)
def test_board_that_cannot_stand_at_a_true_bus_is_refused(
    text: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "hapticd.toml"
    file.write_text(text)
    assert main(["sim-board", "--usbip", "0", "--config", str(file)]) == 78
    assert reason in capsys.readouterr().err
