"""
Where are the poles of the closed loop?
=======================================

Each law moves the six pairs of lightly damped modes. A ring's radius is its natural frequency, the
angle its damping: what comes close to the vertical axis rings. The law that is the report's fastest
with single legs brings a pair to the axis here.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj.analysis.linear.loop import closed_loop

system = cmf_mj.linearize(cmf_mj.Hexapod(cab="gfd"))
figure, axis = plt.subplots(layout="constrained")
for law, mark in (("velocity", "o"), ("force", "x"), ("position_error_rate", "^")):
    poles = closed_loop(law, system).poles()
    rates = np.log(poles[np.abs(poles) > 1e-6]) * 2048 / (2 * np.pi)
    chosen = rates[(rates.imag > 0.3) & (np.abs(rates) < 20)]
    axis.plot(chosen.real, chosen.imag, mark, fillstyle="none", label=law)
for damping in (0.1, 0.3, 0.5):
    axis.plot([0, -20 * damping], [0, 20 * np.sqrt(1 - damping**2)], color="0.8", linewidth=0.8)
    axis.text(-17 * damping, 17 * np.sqrt(1 - damping**2), f"{damping}", color="0.5")
axis.axvline(0.0, color="k", linewidth=0.8)
axis.set(
    title="Closed-loop poles; grey: damping ratio",
    xlabel="real part / 2 pi [Hz]",
    ylabel="imaginary part / 2 pi [Hz]",
    xlim=(-12, 1),
    ylim=(0, 18),
)
figure.legend(loc="outside lower center", ncols=3)
plt.show()
