"""
Where does the energy go?
=========================

The supply gives energy to lift and to lower: the valves turn most of it into heat. What is given
less what is stored, lost and done is the error of the time step, far below the line's width.
"""

import matplotlib.pyplot as plt

import cmf_mj
from cmf_mj import signals
from cmf_mj.plant.hydraulics import ENERGIES

plant = cmf_mj.Hexapod(cab="gfd")
record = cmf_mj.simulate(plant, "velocity", signals.sine("heave", 0.15, 0.5, cycles=4))
energy = dict(zip(ENERGIES, record["energy"].T / 1e3, strict=True))
balance = {
    "delivered": energy["pump"] + energy["accumulators"],
    "lost": sum(energy[name] for name in ENERGIES[2:-2]),
    "work": energy["mechanical"],
}
figure, axis = plt.subplots(layout="constrained")
for name, values in balance.items():
    axis.plot(record.time, values, label=name)
axis.set(
    title="Energy since the start, heave sine of 150 mm at 0.5 Hz",
    xlabel="time [s]",
    ylabel="energy [kJ]",
)
figure.legend(loc="outside lower center", ncols=3)
plt.show()
