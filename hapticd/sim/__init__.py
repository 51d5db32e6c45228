"""The simulated twin of a board: firmware and plant (board, probe), the USB seam it sits behind
(backend), and its faults.
"""
