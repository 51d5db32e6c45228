"""The tick law: what force a virtual environment answers to a position. Standard library only."""
