"""A step in surge: why it is not a step in heave.

The same law on the same hydraulics; in surge a leg feels five times the mass, and the platform
overshoots by half.
"""

import cmf_mj
from cmf_mj import signals

plant = cmf_mj.Hexapod(cab="gfd")
for dof in ("heave", "surge"):
    record = cmf_mj.simulate(plant, "velocity", signals.step(dof, 0.0254, duration=6.0))
    metrics = cmf_mj.step_metrics(record, dof=dof)
    pressure = record["cap_pressure"].max() / 1e5
    print(
        f"{dof}: overshoot {100 * metrics.overshoot:.0f} %, cap pressure up to {pressure:.0f} bar"
    )
