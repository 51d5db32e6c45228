"""The tick law: the force of a virtual environment at a position. Standard library only.

law        render: one tick of the law, compiled by the batch engine too; design_coefficients
filters    second-order low-pass filters for velocity and acceleration
parts      parts of a law of the batch engine: FOAW, Levant, PO/PC
ramp       Ramp: a parameter on its way from one value to the next; approach
energy     book: a ledger of the work of the force and of its excess
winding    the range of the winding's temperature, and its resistance to compensate
"""
