"""Figures and tables from results. They draw what they are given; nothing here drives a device,
prints or opens a window.
"""
