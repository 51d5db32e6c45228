"""
Toggle damping
==============

Switch the active damping under a stiff spring and compare the motion. This is the main result of
Weir, Colgate and Peshkin (2008): the same spring, the same hand, one analog circuit.

The device is ``weir2008``, the simulated display that reproduces the paper's limits: without
damping it renders about 100 N/m, with 1.74 N s/m about 600.
"""

import numpy as np

from hapticd.core.faults import BY_NUMBER
from hapticd.run.lockstep import LockStepClient, scene_params
from hapticd.zwidth.report.style import OFF, ON, WIDTH_IN, Colour, axes, styled

device = LockStepClient(*scene_params("fig7"))  # live: device = Client()

# %%
# A spring beyond the limit
# -------------------------
# 250 N/m is more than twice the limit of the undamped device. Switch on the damping first, then the
# spring, then the force. Noise at the probe replaces a hand that is never still.

NOISE_N = np.random.default_rng(1).normal(0.0, 0.2, 4000)  # 4 kHz
print(f"damping {device.damping('on').effective['active_damping']:.4f} N s/m")
device.set(K=250, B=1)
device.enable()
device.perturb_load(NOISE_N)
device.perturb_start(loop=True)

# %%
# On, off, on, off
# ----------------
# ``damping`` is a change like any other, with a receipt, a revision, and the level after the
# board's 16-bit converter.

parts = []
for asked in ("on", "off", "on", "off"):
    receipt = device.damping(asked)
    records, lost = device.record(seconds=1.0)
    parts.append(records)
    moved_um = 1e6 * records["position_m"].std()
    print(
        f"active damping {receipt.effective['active_damping']:.2f} N s/m:"
        f" {moved_um:.0f} um rms, {lost} lost"
    )

# %%
# The damping in the second panel is what the **board reports**, tick by tick.

records = np.concatenate(parts)
time_s = (records["tick"] - records["tick"][0]) / 1e3
with styled():
    figure, (top, bottom) = axes(2, 1, WIDTH_IN, 3.8, sharex=True)
    for part, look in zip(parts, (ON, OFF, ON, OFF), strict=True):
        at_s = (part["tick"] - records["tick"][0]) / 1e3
        top.plot(at_s, 1e3 * part["position_m"], color=look["color"], linewidth=0.6)
    top.set(ylabel="position (mm)", title="K = 250 N/m under the same noise")
    bottom.plot(time_s, records["active_damping_ns_per_m"], color=Colour.BLUE)
    bottom.set(ylabel="damping (N s/m)", xlabel="time (s)")

# %%
# Too far
# -------
# At 400 N/m the undamped loop gives out more energy than friction dissipates. The servo detects a
# handle that is faster than any hand, ramps the force to 0 in 20 ms, and keeps the damping.

device.damping("on")
device.set(K=400)
calm, _ = device.record(seconds=0.3)
device.damping("off")
loose, _ = device.record(seconds=0.5)
records = np.concatenate([calm, loose])
fault = BY_NUMBER[int(loose["fault"].max())]
print(f"{fault.code}: {fault.cause}")
print(f"remedy: {fault.remedy}")

with styled():
    runaway, (top, bottom) = axes(2, 1, WIDTH_IN, 3.8, sharex=True)
    time_s = (records["tick"] - loose["tick"][0]) / 1e3
    until = time_s <= time_s[np.flatnonzero(records["fault"])[0]] + 0.03
    top.plot(time_s[until], 1e3 * records["position_m"][until], color=OFF["color"])
    top.set(ylabel="position (mm)", title="K = 400 N/m: damping goes off at 0 s")
    bottom.plot(time_s[until], records["force_n"][until], color=OFF["color"])
    bottom.set(ylabel="force (N)", xlabel="time (s)")

# %%
# A daemon warns before anything moves: by the device's model, its :doc:`guard </guard>` finds that
# 400 N/m without damping is not passive. Under the policy ``refuse`` the damping stays on. The
# ``LockStepClient`` of this page has no guard; ``hapticd.virtual_board`` has one.

device.close()
