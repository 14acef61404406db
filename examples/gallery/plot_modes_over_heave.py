"""
Do the modes stay where they are?
=================================

Near the end of its stroke a chamber holds little oil, which is a stiff spring: all six modes rise
towards the ends of heave, and the legs stand at other angles there.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj.show.linearization import mode_names

plant = cmf_mj.Hexapod(cab="gfd")
heave = np.linspace(-0.7, 0.7, 41)
frequency = [plant.hydraulic_modes([0, 0, z, 0, 0, 0]).frequency_hz for z in heave]
figure, axis = plt.subplots(layout="constrained")
axis.plot(heave, frequency, label=mode_names(plant.hydraulic_modes()))
axis.set(
    title="Hydraulic modes over heave, Generic Flight Deck",
    xlabel="heave, positive down [m]",
    ylabel="natural frequency [Hz]",
    ylim=(0, None),
)
figure.legend(loc="outside lower center", ncols=3)
plt.show()
