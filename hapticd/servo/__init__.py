"""The servo process: one thread, one loop, one tick after another. Standard library, pyusb and
the floors below.
"""
