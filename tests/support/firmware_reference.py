"""The reference firmware (firmware_iface/reference): what it takes and refuses, and that it does
frame by frame what the simulated board does, whatever a host does to both.
"""

CASE_BYTES = 4000  # about 210 frames
