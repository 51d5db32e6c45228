"""Weir, Colgate and Peshkin (2008), "Measuring and Increasing Z-Width with Active Electrical
Damping", measured again with the bench.

paper          what the paper says: its devices, conditions and printed values
run            what is measured, in terms of `zwidth`: trials, limits, map, walls
table          each quantity beside the paper's, with the reason where they differ
figures        the paper's figures from our results
page           REPORT.md
future_work    section 6 of the paper: negative B, shaped damping, levels, directed search
future_page    its rows, words and figures

Only the command line imports this package: it uses the bench as any script may.
"""
