"""
The machine, drawn
==================

The model that is simulated has a drawn twin: MuJoCo renders it in any pose. Surge is forward, sway
to the right, heave down.
"""

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import cmf_mj

poses = {
    "neutral": [0, 0, 0, 0, 0, 0],
    "surge 0.8 m": [0.8, 0, 0, 0, 0, 0],
    "heave down 0.7 m": [0, 0, 0.7, 0, 0, 0],
    "roll 15 deg": np.radians([0, 0, 0, 15, 0, 0]),
}
plant = cmf_mj.Hexapod(cab="gfd")
model = plant.drawn_model
data = mujoco.MjData(model)
figure, axes = plt.subplots(2, 2, layout="constrained", figsize=(9, 7))
figure.suptitle("Generic Flight Deck on the Cockpit Motion Facility")
with mujoco.Renderer(model, 360, 480) as renderer:
    for axis, (title, pose) in zip(axes.flat, poses.items(), strict=True):
        plant.place(pose)
        data.qpos[:] = plant.data.qpos
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, camera=0)
        axis.imshow(renderer.render())
        axis.set(xlabel=title, xticks=[], yticks=[])
plt.show()
