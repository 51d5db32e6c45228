"""The reference firmware (firmware_iface/reference): accepted and refused input, and the comparison
with the simulated board frame by frame, for any behaviour of the host.
"""

CASE_BYTES = 4000  # about 210 frames
