"""The simulated board behind USB/IP: the frames of the fake backend, the errors of a controller."""

DEADLINE_S = 60.0
