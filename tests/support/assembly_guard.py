"""The guard's worker: what it starts from, what it says, and that it outlives a bad request."""

from support.guard_device import (
    request,
)

REQUEST = request({"K": 20.0}, n=7)
