"""Weir, Colgate and Peshkin (2008), "Measuring and Increasing Z-Width with Active Electrical
Damping", measured again with the bench.

paper           the paper's printed numbers, and the devices that represent its device; the numbers
                and the text of the report are in rows.toml
run             the measurements, in terms of `zwidth`: trials, limits, map, walls
rows            comparison of each quantity with the paper, with the reason of a difference
table           the rows as text, Markdown and JSON
figures         the paper's Figs. 3, 4 and 7-11, and two of our own
page            REPORT.md and its files
future_work     section 6 of the paper: negative B, shaped damping, levels, directed search
future_figures  its figures
future_page     its rows and its sections of REPORT.md

`python -m examples.weir2008` runs everything. A script calls `plan_reproduce` and `run_reproduce`
of `run`, and `rows.rows`, or, for section 6, `future_work.plan_future_work` and
`future_work.run_future_work`; `page.keep` writes the folder. Only public names of hapticd are used,
those in the `__all__` of its modules (docs/adr/0033-paper-outside-the-package.md).
"""
