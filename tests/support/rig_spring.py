"""`rig motor --spring` and `--offset` at rigs whose gain and offset differ from the device file."""

from hapticd.rig.steps.motor import Spring

SPRING = Spring(300.0, 0.005)
