"""The guard's worker: its start, its answers, and its survival of an invalid request."""

from support.guard_device import (
    request,
)

REQUEST = request({"K": 20.0}, n=7)
