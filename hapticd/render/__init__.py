"""The tick law: the force of a virtual environment at a position. Standard library only.

law        render: one tick of the law, compiled by the batch engine too; design_coefficients;
           second-order low-pass filters for velocity and acceleration; Ramp: a parameter on its way
           from one value to the next; approach; book: a ledger of the work of the force and of its
           excess
winding    the range of the winding's temperature, and its resistance to compensate
"""
