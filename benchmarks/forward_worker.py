"""A minimal forwarder of telemetry, and its subscriber: only the cost of packing and sending the
same maps.

python -m benchmarks.forward_worker forward INSTANCE ENDPOINT   reads the instance's ring, sends on
                                                                ENDPOINT until terminated
python -m benchmarks.forward_worker listen ENDPOINT SECONDS     prints `{}` at the first block, then
                                                                the number of its records
"""

import json
import sys
import time

import msgpack
import zmq

from hapticd.core.params import GatewayParams
from hapticd.mailbox import files, layout
from hapticd.protocol.telemetry import TICK_DESCR

PAUSE_S = 0.01  # like the gateway's
TOPIC = b"servo.raw"
BATCH = GatewayParams().batch
SILENCE_MS = 10_000


def forward(instance: str, endpoint: str) -> None:
    """Send the complete batches every 10 ms, as the map of `servo.raw`."""
    page = files.open_map(
        files.runtime_folder(instance) / files.TELEMETRY, layout.TELEMETRY_BYTES, writable=False
    )
    words = memoryview(page).cast("Q")
    size = layout.RECORD.size
    slots = layout.RING_RECORDS
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.XPUB)
    socket.bind(endpoint)
    header = {
        "v": 1,
        "epoch": words[layout.TELEMETRY_EPOCH_WORD],
        "mono_unix_offset_ns": 0,
        "simulated": True,
    }
    header["layout"] = layout.LAYOUT_HASH.hex()
    tail = words[layout.TELEMETRY_HEAD_WORD]
    while True:
        time.sleep(PAUSE_S)
        while words[layout.TELEMETRY_HEAD_WORD] - tail >= BATCH:
            places = (
                layout.TELEMETRY_OFFSET + number % slots * size for number in (tail, tail + BATCH)
            )
            begin, end = places
            data = page[begin:end] if begin < end else page[begin : begin + BATCH * size]
            place = {
                "seq": tail,
                "next": tail + BATCH,
                "n": BATCH,
                "lost": 0,
                "descr": TICK_DESCR,
                "d": data,
            }
            socket.send_multipart([TOPIC, msgpack.packb(header | place)], zmq.DONTWAIT)
            tail += BATCH


def listen(endpoint: str, seconds: str) -> None:
    """Count the records of `seconds` after the first block."""
    context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
    socket = context.socket(zmq.SUB)
    socket.setsockopt(zmq.RCVTIMEO, SILENCE_MS)
    socket.setsockopt(zmq.SUBSCRIBE, TOPIC)
    socket.connect(endpoint)
    socket.recv_multipart()
    print("{}", flush=True)
    records = 0
    end = time.monotonic() + float(seconds)
    while time.monotonic() < end:
        records += msgpack.unpackb(socket.recv_multipart()[1])["n"]
    print(json.dumps({"records": records}), flush=True)


if __name__ == "__main__":
    {"forward": forward, "listen": listen}[sys.argv[1]](*sys.argv[2:])
