"""
One gain, three axes
====================

The gain on leg velocity damps the modes and changes the bandwidth little. Surge still peaks by 8 dB
where heave and pitch have no peak left: one number does not suit all three.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj.analysis.measures import measure_loop

linear = cmf_mj.Linear(cmf_mj.Hexapod(cab="gfd"))
velocity = cmf_mj.load_law("velocity")
gains = np.linspace(0.7, 1.4, 8)
bandwidth = {"surge": [], "heave": [], "pitch": []}
peak = {dof: [] for dof in bandwidth}
for factor in gains:
    gain = velocity.direct_gain.velocity * factor
    direct = velocity.direct_gain.model_copy(update={"velocity": gain})
    law = velocity.model_copy(update={"direct_gain": direct})
    for dof in bandwidth:
        found = measure_loop(linear.loop(law, dof))
        bandwidth[dof].append(found.phase_bandwidth_hz)
        peak[dof].append(found.peak_gain_db)
figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")
for dof in bandwidth:
    top.plot(gains, bandwidth[dof], ".-", label=dof)
    bottom.plot(gains, peak[dof], ".-")
top.set(
    title="Velocity feedback with other gain on velocity", ylabel="-90 deg [Hz]", ylim=(2.5, 3.0)
)
bottom.set(xlabel="gain over the report's", ylabel="peak [dB]")
figure.legend(loc="outside lower center", ncols=3)
plt.show()
