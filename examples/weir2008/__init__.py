"""Weir, Colgate and Peshkin (2008), "Measuring and Increasing Z-Width with Active Electrical
Damping", measured again with the bench.

paper           what the paper prints, and the devices that stand for the paper's; its numbers, and
                the words of the report, stand in rows.toml
run             what is measured, in terms of `zwidth`: trials, limits, map, walls
rows            each quantity beside the paper's, with the reason where they differ
table           the rows as text, Markdown and JSON
figures         the paper's Figs. 3, 4 and 7-11, and two of our own
page            REPORT.md and the files beside it
future_work     section 6 of the paper: negative B, shaped damping, levels, directed search
future_figures  its figures
future_page     its rows and its sections of REPORT.md

`python -m examples.weir2008` does it all. A script calls `plan_reproduce` and `run_reproduce` of
`run`, and `rows.rows`, or, for section 6, `future_work.plan_future_work` and
`future_work.run_future_work`; `page.keep` writes the folder. Of hapticd only public names are used,
those in the `__all__` of its modules (docs/adr/0033-paper-outside-the-package.md).
"""
