"""Attacks on the daemon: what each does, and the counter that would show a loss (`table`)."""
