"""
What the oil does in a step
===========================

At rest the larger area of the cap side carries the weight. A step of 1 in down lets its oil out:
its pressure falls at once, and both sides ring with the mode of heave.
"""

import matplotlib.pyplot as plt

import cmf_mj
from cmf_mj import signals

plant = cmf_mj.Hexapod(cab="gfd")
record = cmf_mj.simulate(plant, "velocity", signals.step("heave", 0.0254, at=0.5, duration=2.5))
figure, (top, middle, bottom) = plt.subplots(3, sharex=True, layout="constrained", figsize=(7, 7))
top.plot(record.time, 1000 * record["leg_reference"][:, 0], "k--", label="demand")
top.plot(record.time, 1000 * record["leg_extension"][:, 0], label="leg 1")
top.set(title="Heave step of 1 in down, leg 1", ylabel="extension [mm]")
middle.plot(record.time, 100 * record["valve_command"][:, 0], label="command")
middle.plot(record.time, 100 * record["valve_opening"][:, 0], label="opening")
middle.set(ylabel="valve [%]")
bottom.plot(record.time, record["cap_pressure"][:, 0] / 1e5, label="cap side")
bottom.plot(record.time, record["rod_pressure"][:, 0] / 1e5, label="rod side")
bottom.set(xlabel="time [s]", ylabel="pressure [bar]")
for axis in (top, middle, bottom):
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
plt.show()
