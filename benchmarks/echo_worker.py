"""The least that a command can cost: a ROUTER that sends back what it gets. Argument: endpoint."""

import sys

import zmq


def main() -> None:
    """Serve until an empty message."""
    context = zmq.Context()
    socket = context.socket(zmq.ROUTER)
    socket.bind(sys.argv[1])
    while True:
        parts = socket.recv_multipart()
        socket.send_multipart(parts)
        if not parts[-1]:
            break
    context.destroy(linger=100)


if __name__ == "__main__":
    main()
