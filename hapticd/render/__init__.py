"""The tick law: what force a virtual environment answers to a position. Standard library only.

law      render: one tick of the law, compiled by the batch engine too; design_coefficients
filters  second-order low-pass filters for velocity and acceleration
ramp     Ramp: how a parameter goes from one value to the next; approach
energy   book: a ledger of the work of each part of the force
winding  how hot the winding can be, and how much of its resistance may be compensated
"""
