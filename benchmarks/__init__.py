"""What hapticd must reach, measured: `make bench`, or `python benchmarks/run.py --only wake`.
See docs/development/benchmarks.md.
"""
