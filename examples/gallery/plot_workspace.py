"""
How far can it go?
==================

Surge and heave share the legs' working travel: the corner of one is paid with the other. The line
is where the first leg reaches it, at three pitch angles.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj

machine = cmf_mj.load_machine("cmf")
surge, heave = np.meshgrid(np.linspace(-2.5, 2.5, 251), np.linspace(-1.5, 1.5, 151))
figure, axis = plt.subplots(layout="constrained")
for pitch, colour in ((0.0, "tab:blue"), (10.0, "tab:orange"), (20.0, "tab:green")):
    poses = np.zeros((*surge.shape, 6))
    poses[..., 0], poses[..., 2], poses[..., 4] = surge, heave, np.radians(pitch)
    legs = cmf_mj.pose_to_legs(poses.reshape(-1, 6), machine).reshape(*surge.shape, 6)
    share = np.abs(legs).max(axis=-1) / machine.working_stroke
    axis.contour(surge, heave, share, levels=[1.0], colors=colour)
    axis.plot([], [], color=colour, label=f"pitch {pitch:.0f} deg")
axis.set(
    title="Poses within the legs' working travel", xlabel="surge [m]", ylabel="heave, down [m]"
)
axis.invert_yaxis()
axis.set_aspect("equal")
figure.legend(loc="outside lower center", ncols=3)
plt.show()
