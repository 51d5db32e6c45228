"""
First script
============

Set a spring, push against it, and inspect every tick of the motion.

A script talks to a running daemon through a **client**:

.. code-block:: python

    from hapticd.client import Client

    with Client() as device:
        ...

Here the same client is connected to a simulated board on **virtual time**: its clock advances only
during a recording, so this page needs no daemon. All other code is the same with a real device.
"""

import numpy as np

from hapticd.run.virtual import virtual_board
from hapticd.settings.load import load
from hapticd.zwidth.report.style import WIDTH_IN, Colour, axes, styled

device = virtual_board()  # live: device = Client()
print(device.status().state)

# %%
# A change and its receipt
# ------------------------
# A servo starts disabled and renders nothing. ``set`` changes the environment, and the receipt
# contains the first tick and the resulting values. Active damping is switched on first: without it
# this spring is not passive on this device, and a ``GuardWarning`` would report it.

device.damping("on")
device.run(200)  # ticks, until it has arrived; live, time advances by itself
receipt = device.set(K=200, B=1)
print(f"revision {receipt.revision}, ticks {receipt.first_tick} to {receipt.ramp_end_tick}")
print(f"K = {receipt.effective['K']:g} N/m, B = {receipt.effective['B']:g} N s/m")

# %%
# Force on
# --------
# ``enable`` ramps the force up over half a second. Then the probe's motor plays a waveform in a
# loop, 4000 samples a second.

PUSH_N = 0.2
RATE_HZ = 5.0
device.enable()
device.perturb_load(PUSH_N * np.sin(2 * np.pi * RATE_HZ * np.arange(4000) / 4000))
device.perturb_start(loop=True)

# %%
# Every tick
# ----------
# ``record`` returns a numpy structured array, one record a tick, and the number of missing records.
# Names of fields contain their units.

records, lost = device.record(seconds=1.0)
print(f"{len(records)} ticks, {lost} lost")
print(", ".join(records.dtype.names[:12]), "...")

with styled():
    figure, (top, bottom) = axes(2, 1, WIDTH_IN, 3.6, sharex=True)
    time_s = (records["tick"] - records["tick"][0]) / 1e3
    top.plot(time_s, 1e3 * records["position_m"], color=Colour.BLUE)
    top.set(ylabel="position (mm)", title="A spring of 200 N/m, pushed with 0.2 N at 5 Hz")
    bottom.plot(time_s, records["force_n"], color=Colour.ORANGE)
    bottom.set(ylabel="rendered force (N)", xlabel="time (s)")

# %%
# An experiment
# -------------
# Set one stiffness after another. Each record contains the revision in force, so the receipt's last
# tick excludes the ramp, and no clocks have to be compared. Textbook mechanics predict the motion
# of the simulated device: x = F / \|K - M w^2 + j w b\|, where b is the sum of virtual, active and
# mechanical damping.

plant = load(None).device.plant
w = 2 * np.pi * RATE_HZ
for stiffness in (50, 100, 200, 400):
    receipt = device.set(K=stiffness, B=1.0, ramp_s=0.2)
    device.record(seconds=1.0)  # until the transient has decayed
    records, lost = device.record(seconds=1.0)
    assert (records["revision"] == receipt.revision).all()
    moved_mm = 1e3 * np.sqrt(2) * records["position_m"].std()
    b = 1.0 + receipt.effective["active_damping"] + plant.viscous_ns_per_m
    dynamic = stiffness - plant.mass_kg * w**2 + 1j * w * b
    expected_mm = 1e3 * PUSH_N / abs(dynamic)
    print(f"K = {stiffness:3d} N/m: moved {moved_mm:.3f} mm, expected {expected_mm:.3f} mm")

# %%
# The motion is up to 3 % smaller: B uses a filtered velocity that is about 3 ms old, and a force
# with such a delay also acts like a stiffness.
#
# Stop
# ----
# Any client can stop the device at any time. The stop latches: ``enable`` is refused until a reset,
# and a reset does not enable.

device.stop()
device.run(1100)  # For a second no other client may undo a stop.
print(device.status().state)
device.reset()
print(device.status().state)
device.close()

# %%
# Next: :doc:`t2_toggle_damping`. Conditions in balanced random order, and a table that joins
# answers to telemetry, are in :mod:`hapticd.client.design`; ``examples/jnd.py`` is a whole
# experiment.
