"""Bytes in, values out: frames, codec and session of the USB protocol. No I/O, no clock,
standard library only.
"""
