"""Hydraulics on an MJCF of your own: a lift of three tonnes, its valve opened by a fifth.

Any slide joint or tendon takes a cylinder with two servo-valves; one supply feeds them all.
"""

import mujoco
import numpy as np

import cmf_mj

MODEL = """
<mujoco model="lift">
  <worldbody>
    <body>
      <joint name="ram" type="slide" axis="0 0 1" range="0 1.9304"/>
      <geom type="box" size="0.5 0.5 0.1" mass="3000"/>
    </body>
  </worldbody>
</mujoco>
"""

plant = cmf_mj.attach_hydraulics(mujoco.MjSpec.from_string(MODEL), ["ram"], "hardware")
valve = np.full((2048, 1), 0.2)  # one second at the control rate of 2048 Hz
record = cmf_mj.drive(plant, valve, start=plant.configuration([0.0]))
print(f"risen by {record['leg_extension'][-1, 0]:.3f} m")
print(f"cap pressure {record['cap_pressure'][-1, 0] / 1e5:.0f} bar")
print(f"supply pressure {record['supply_pressure'][-1] / 1e5:.0f} bar")
