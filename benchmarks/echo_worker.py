"""Minimum cost of a command: a ROUTER that returns each message. Argument: endpoint."""

import sys

import zmq


def main() -> None:
    """Serve until terminated."""
    context = zmq.Context()
    socket = context.socket(zmq.ROUTER)
    socket.bind(sys.argv[1])
    while True:
        socket.send_multipart(socket.recv_multipart())


if __name__ == "__main__":
    main()
