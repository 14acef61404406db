"""
Which excitation has its power where?
=====================================

A chirp and noise fill a band, a multisine has the lines you choose, seven sines are those of the
facility's own rounds. All have an amplitude of 0.33 in.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy import signal

from cmf_mj import signals
from cmf_mj.show.look import frequency_axis

size = 0.33 * 0.0254
commands = {
    "seven sines": signals.seven_sines("heave", size, 1),
    "chirp": signals.chirp("heave", size, duration=30.0),
    "noise": signals.noise("heave", size, duration=30.0, seed=1),
    "multisine": signals.multisine("heave", size, periods=2),
}
figure, axes = plt.subplots(4, 2, layout="constrained", figsize=(9, 8))
for (name, command), (left, right) in zip(commands.items(), axes, strict=True):
    heave = 1000 * command.pose[:, 2]
    time = np.arange(heave.size) / 2048
    frequency, power = signal.periodogram(heave, 2048)
    left.plot(time, heave, linewidth=0.5)
    left.set(title=name, ylabel="[mm]", xlim=(0, 100))
    right.plot(frequency[1:], power[1:] + 1e-12, linewidth=0.5)
    frequency_axis(right.xaxis)
    right.set(xlim=(0.05, 30), ylim=(1e-12, None), yscale="log", xlabel="", ylabel="[mm^2/Hz]")
axes[-1, 0].set_xlabel("time [s]")
axes[-1, 1].set_xlabel("frequency [Hz]")
plt.show()
