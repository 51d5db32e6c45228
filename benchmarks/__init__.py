"""Benchmarks of hapticd against its targets: `make bench`, or `python benchmarks/run.py --only
wake`. See docs/development/benchmarks.md.
"""
