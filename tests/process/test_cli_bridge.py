"""The outlet of the Lab Streaming Layer, received by LSL's own inlet on this host."""

import threading

import numpy as np
import pylsl
import pytest

from hapticd.cli import network
from hapticd.cli.app import main
from hapticd.client.blocks import Excerpt

pytestmark = pytest.mark.process


class Ticking:
    """The client of a daemon whose ticks come once somebody listens, on virtual time."""

    def __init__(self, board):
        self.hello = board.hello
        self.board = board
        self.heard = threading.Event()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def stream(self, seconds):
        assert self.heard.wait(60.0)
        excerpt = Excerpt("servo.raw", seconds, None)
        for message in self.board.messages(("servo.raw",)):
            if message is not None:
                yield excerpt.next(message[1])
            if excerpt.complete:
                return


def test_every_tick_comes_out_of_lsl_with_the_stamp_of_the_servo(hapticd_board, monkeypatch):
    """LSL has threads and sockets of its own."""
    device = Ticking(hapticd_board)
    monkeypatch.setattr(network, "connect", lambda instance: device)
    codes = []
    words = ["bridge", "lsl", "--seconds", "1.0"]
    thread = threading.Thread(target=lambda: codes.append(main(words)))
    thread.start()
    (info,) = pylsl.resolve_byprop("name", "hapticd", timeout=60.0)
    inlet = pylsl.StreamInlet(info)
    inlet.open_stream(timeout=60.0)
    device.heard.set()
    samples = []
    stamps = []
    while len(samples) < 1000:
        rows, times = inlet.pull_chunk(timeout=60.0, max_samples=1000)
        assert times, "no samples within a minute"
        samples += rows
        stamps += times
    thread.join(60.0)
    assert codes == [0]
    assert inlet.info().nominal_srate() == 1000.0
    assert inlet.info().get_channel_labels() == list(network.CHANNELS)
    assert np.shape(samples) == (1000, len(network.CHANNELS))
    assert np.diff(stamps) == pytest.approx(1e-3, abs=1e-9)
