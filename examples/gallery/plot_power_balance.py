"""
Where does the energy go?
=========================

The supply gives energy to lift and to lower: the valves turn most of it into heat. What is given
less what is stored, lost and done is the error of the time step, far below the line's width.
"""

import matplotlib.pyplot as plt

import cmf_mj
from cmf_mj import signals
from cmf_mj.plant.power_balance import power_balance

plant = cmf_mj.Hexapod(cab="gfd")
record = cmf_mj.simulate(plant, "velocity", signals.sine("heave", 0.15, 0.5, cycles=4))
balance = power_balance(plant, record)
figure, axis = plt.subplots(layout="constrained")
for name in ("delivered", "lost", "work"):
    axis.plot(record.time, getattr(balance, name) / 1e3, label=name)
axis.set(
    title="Energy since the start, heave sine of 150 mm at 0.5 Hz",
    xlabel="time [s]",
    ylabel="energy [kJ]",
)
axis.legend()
plt.show()
