"""The compensation of a winding that the tests of servo and gateway share."""

from hapticd.core.params import ResistanceParams, ScaleParams

TABLE = ResistanceParams(
    trim=ScaleParams(0.8 / 32767),
    full_scale_ohm=0.8,
    base_ohm=1.5,
    winding_ohm=1.6,
    reference_c=20.0,
    per_k=0.00393,
    tolerance_ohm=0.03,
    slew_ohm_per_s=0.1,
    force_n_per_a=1.65,
    heat_from="current",
    thermal_resistance_k_per_w=8.0,
    time_constant_s=10.0,
    ambient_low_c=15.0,
    ambient_high_c=25.0,
    model_error=0.1,
)
