"""hapticd: a real-time haptic servo daemon, its gateway and its simulated board."""

__version__ = "0.1.0"
