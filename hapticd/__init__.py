"""hapticd: a haptic servo daemon, its gateway, its simulated board, and the bench that measures it.

Scripts use `hapticd.client` to talk to a daemon; each package says in its own face what it is and
which of its names scripts may use. docs/OVERVIEW.md says where everything is.
"""

__version__ = "0.1.0"
