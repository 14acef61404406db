"""
How fast can it move at each frequency?
=======================================

The largest heave sine meets one limit after the other as its frequency rises: displacement, the
pump's flow, the valves behind their lags, the stall of a leg. Each line is a closed form and knows
no law.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj.show.look import frequency_axis
from cmf_mj.studies.asymptotes import asymptotes

frequency = np.geomspace(0.1, 10.0, 200)
limits = asymptotes(cmf_mj.Hexapod(cab="gfd"), "heave")
velocities = [limits.velocities(hertz) for hertz in frequency]
figure, axis = plt.subplots(layout="constrained")
for name in velocities[0]:
    axis.loglog(frequency, [row[name] for row in velocities], label=name.replace("_", " "))
least = [min(row.values()) for row in velocities]
axis.loglog(frequency, least, color="black", linewidth=2.5, label="largest sine")
axis.set(title="Heave of the machine with its lightest cab", ylim=(0.3 * min(least), 4.0))
axis.set_ylabel("velocity amplitude [m/s]")
frequency_axis(axis.xaxis)
figure.legend(loc="outside lower center", ncols=3)
plt.show()
