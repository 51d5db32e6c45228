"""Composition roots: where clocks, boards, links, loops and processes are put together.
Import-light, silent.
"""
