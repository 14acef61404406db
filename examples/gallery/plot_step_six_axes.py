"""
One step in each axis
=====================

Velocity feedback follows a step of 1 in or 0.6 deg. The legs swing a heavy mass in surge and sway
and a light one in pitch and roll: the same gains ring in one axis and creep in another.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj import signals

plant = cmf_mj.Hexapod(cab="gfd")
figure, axes = plt.subplots(2, 3, sharex=True, sharey=True, layout="constrained", figsize=(9, 5))
for index, (dof, axis) in enumerate(
    zip(("surge", "sway", "heave", "roll", "pitch", "yaw"), axes.flat, strict=True)
):
    size = 0.0254 if index < 3 else np.radians(0.6)
    record = cmf_mj.simulate(plant, "velocity", signals.step(dof, size, at=0.5, duration=6.0))
    overshoot = cmf_mj.step_metrics(record, dof=dof).overshoot
    axis.plot(record.time, record["platform_pose"][:, index] / size)
    axis.axhline(1.0, color="0.7", linewidth=0.8)
    axis.set_xlim(0.0, 3.0)
    axis.set_title(f"{dof}: {100 * overshoot:.0f} % overshoot")
figure.supxlabel("time [s]")
figure.supylabel("platform over demand")
plt.show()
