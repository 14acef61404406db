"""
Why is surge not heave?
=======================

With the valves shut, the platform swings on the oil of its six legs. In surge and sway a leg
carries several times the mass it carries in heave, so these modes are the slowest: no law that
only looks at one leg can be right for all six axes.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj.show.linearization import mode_names

figure, (left, right) = plt.subplots(1, 2, layout="constrained", figsize=(9, 4))
for offset, cab in enumerate(("gfd", "rfd", "ifd")):
    modes = cmf_mj.Hexapod(cab=cab).hydraulic_modes()
    where = np.arange(6) + 0.27 * (offset - 1)
    left.bar(where, modes.frequency_hz, 0.25, label=cab)
    right.bar(where, modes.leg_mass / 1000.0, 0.25)
left.set(title="Natural frequency with valves shut", xlabel="mode", ylabel="[Hz]")
right.set(title="Mass that a leg feels", xlabel="mode", ylabel="[t]")
for axis in (left, right):
    axis.set_xticks(range(6), mode_names(modes), rotation=45, ha="right")
figure.legend(loc="outside lower center", ncols=3)
plt.show()
