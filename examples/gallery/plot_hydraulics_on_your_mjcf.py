"""
Hydraulics on a model of your own
=================================

A press in eight lines of MJCF gets a cylinder, valves and a supply. A step of the valve lifts three
tonnes; shutting it lets the load swing on the oil.
"""

import matplotlib.pyplot as plt
import mujoco
import numpy as np

import cmf_mj

press = mujoco.MjSpec.from_string("""
<mujoco model="press"><worldbody><body>
  <joint name="ram" type="slide" axis="0 0 1" range="0 1.9304"/>
  <geom type="box" size="0.5 0.5 0.1" mass="3000"/>
</body></worldbody></mujoco>""")
plant = cmf_mj.attach_hydraulics(press, ["ram"], "hardware")
valve = np.zeros((4096, 1))
valve[256:2048] = 0.3
record = cmf_mj.drive(plant, valve, start=plant.configuration([0.0]))
figure, (top, middle, bottom) = plt.subplots(3, sharex=True, layout="constrained", figsize=(7, 6))
top.plot(record.time, 100 * record["valve_opening"])
top.set(title="A press on one cylinder", ylabel="valve [%]")
middle.plot(record.time, record["leg_extension"])
middle.set(ylabel="ram [m]")
bottom.plot(record.time, record["cap_pressure"] / 1e5, label="cap side")
bottom.plot(record.time, record["rod_pressure"] / 1e5, label="rod side")
bottom.set(xlabel="time [s]", ylabel="pressure [bar]")
bottom.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
plt.show()
