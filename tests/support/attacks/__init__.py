"""Attacks on the daemon: the action of each, and the counter that shows a loss (`table`)."""
