"""
What a heavier cab costs
========================

The Generic Flight Deck's mass is multiplied, its inertia in proportion. The modes fall with the
root of the mass that the legs feel, of which the platform keeps its part.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj

gfd = cmf_mj.load_cab("gfd")
factors = np.linspace(0.5, 2.0, 16)
frequency = []
for factor in factors:
    cab = gfd.changed("mine", mass=factor * gfd.mass.si)
    frequency.append(cmf_mj.Hexapod(cab).hydraulic_modes().frequency_hz)
figure, axis = plt.subplots(layout="constrained")
axis.plot(factors, frequency)
axis.axvline(1.0, color="0.6", linewidth=0.8)
axis.set(
    title="Hydraulic modes with another cab",
    xlabel="mass over the Generic Flight Deck's",
    ylabel="natural frequency [Hz]",
    ylim=(0, None),
)
plt.show()
