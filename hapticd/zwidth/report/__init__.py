"""Figures and tables from results. They draw what they are given; nothing here drives a device,
prints or opens a window.

style        colours, lines and axes that all figures share; `save` writes PNG, SVG and PDF
paper        what the width of a figure asks for: type, panels, legend, words
trial        one trial: impedance with its interval, escape, replayed recordings
envelope     the Z-width envelope and which environments own its edges
passive_set  maps, limits, directed search, walls
comparison   several displays beside each other (`zwidth compare`)
table        tables as aligned text, durations and shares in words
"""
