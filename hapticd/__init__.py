"""hapticd: a real-time haptic servo daemon, its gateway and its simulated board."""

from hapticd.errors import GuardWarning

__all__ = ["GuardWarning", "__version__"]

__version__ = "0.1.0"
