"""
When does the supply run short?
===============================

The supply keeps its pressure in a sine of 15 in at 0.25 Hz. At 0.35 Hz the legs take more oil
than the pumps give, the accumulators empty cycle by cycle, and the pressure falls.
"""

import matplotlib.pyplot as plt

import cmf_mj
from cmf_mj import signals

plant = cmf_mj.Hexapod(cab="gfd")
figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")
for frequency in (0.25, 0.35):
    demand = signals.sine("heave", 15 * 0.0254, frequency, cycles=round(24 * frequency))
    record = cmf_mj.simulate(plant, "velocity", demand, record_every=16)
    top.plot(record.time, record["supply_pressure"] / 1e5, label=f"{frequency} Hz")
    bottom.plot(record.time, 1000 * record["accumulator_oil"])
top.set(title="Heave sine of 15 in on the facility's supply", ylabel="supply [bar]")
bottom.set(xlabel="time [s]", ylabel="oil in each accumulator [l]")
figure.legend(loc="outside lower center", ncols=2)
plt.show()
