"""
What a leg feels: the reflected mass
====================================

Column j is the force on every leg when leg j accelerates by 1 m/s^2 and the others do not. A model
of single legs has only a diagonal; the blue and red beside it is what couples the legs.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj

plant = cmf_mj.Hexapod(cab="gfd")
poses = {"at neutral": np.zeros(6), "rolled by 15 deg": np.radians([0, 0, 0, 15, 0, 0])}
figure, axes = plt.subplots(1, 2, layout="constrained", figsize=(9, 4))
for axis, (title, pose) in zip(axes, poses.items(), strict=True):
    mass = plant.reflected_mass(pose) / 1000.0
    image = axis.imshow(mass, cmap="RdBu_r", vmin=-10, vmax=10)
    for (row, column), value in np.ndenumerate(mass):
        axis.text(column, row, f"{value:.1f}", ha="center", va="center", fontsize=8)
    axis.set(title=f"Reflected mass {title}", xlabel="leg that moves", ylabel="leg that pushes")
    axis.set_xticks(range(6), range(1, 7))
    axis.set_yticks(range(6), range(1, 7))
figure.colorbar(image, ax=axes, label="[t]", extend="both")
plt.show()
