"""A ten-line experiment: drive the device with a 5 Hz force and measure its motion at several
stiffnesses. No other client can change anything, and force is switched off if the script dies.
"""

import numpy as np
from connect import arguments, connected

asked = arguments("How far 0.2 N at 5 Hz moves several springs.").parse_args()
with (
    connected(asked, "sweep") as device,
    device.lease("environment", at_end="disable"),
    device.lease("perturbation"),
):
    time_s = np.arange(4000) / 4000
    device.perturb_load(0.2 * np.sin(2 * np.pi * 5 * time_s))  # N, one second at 4 kHz
    device.damping(1.74)  # N s/m: without it the stiffer springs would shake the handle
    device.enable()
    device.perturb_start(loop=True)
    for stiffness in (50, 100, 200, 400):
        receipt = device.set(K=stiffness, B=1.0, ramp_s=0.2)
        records, lost = device.record(seconds=1.0)
        x = 1e3 * records["position_m"][records["tick"] >= receipt.ramp_end_tick]
        print(
            f"K = {stiffness:3d} N/m: {np.sqrt(np.mean(x**2)):.3f} mm rms over {len(x)} ticks,"
            f" {lost} lost"
        )
    device.disable()
