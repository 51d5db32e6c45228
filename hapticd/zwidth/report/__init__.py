"""Figures and tables from results. Nothing here drives a device, prints or opens a window.

style        colours, lines and axes of all figures; `save` writes PNG, SVG and PDF
paper        effects of the width of a figure: type, panels, legend, line breaks; tables as aligned
             text, formatted durations and shares
trial        one trial: impedance with its interval, escape, replayed recordings
envelope     the Z-width envelope and the environments that own its edges
passive_set  maps, limits, directed search, walls
comparison   comparison of displays (`zwidth compare`)
"""
