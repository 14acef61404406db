"""
What a heavier cab costs
========================

The Generic Flight Deck's mass is multiplied, its inertia in proportion. The modes fall with the
root of the mass that the legs feel, of which the platform keeps its part.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj.show.linearization import mode_names

gfd = cmf_mj.load_cab("gfd")
factors = np.linspace(0.5, 2.0, 16)
frequency = []
for factor in factors:
    cab = gfd.changed("mine", mass=factor * gfd.mass.si)
    modes = cmf_mj.Hexapod(cab).hydraulic_modes()
    frequency.append(modes.frequency_hz)
figure, axis = plt.subplots(layout="constrained")
axis.plot(factors, frequency, label=mode_names(modes))
axis.axvline(1.0, color="0.6", linewidth=0.8)
axis.set(
    title="Hydraulic modes with another cab",
    xlabel="mass over the Generic Flight Deck's",
    ylabel="natural frequency [Hz]",
    ylim=(0, None),
)
figure.legend(loc="outside lower center", ncols=3)
plt.show()
