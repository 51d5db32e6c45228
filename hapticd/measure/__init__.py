"""Procedures: frozen Params become a Plan, a Plan becomes a Result. They drive devices, here
simulated ones, and print nothing.

What takes long tells how far it is (`progress`); what is timed reads the clock it was given.
"""
