"""
Is the machine linear?
======================

No: a valve command ends at 100 %. Eighty runs side by side give the gain at 3 Hz; it falls from the
amplitude on at which the law asks for more.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj

FREQUENCY, SECONDS, RATE = 3.0, 3.0, 2048
time = np.arange(round(SECONDS * RATE)) / RATE
sine = np.sin(2 * np.pi * FREQUENCY * time)
amplitudes = np.geomspace(0.0005, 0.06, 40)
plant = cmf_mj.Hexapod(cab="gfd")
last = time >= SECONDS - 2 / FREQUENCY
figure, axis = plt.subplots(layout="constrained")
for law in ("velocity", "position_error_rate"):
    poses = np.zeros((amplitudes.size, time.size, 6))
    poses[:, :, 2] = amplitudes[:, None] * sine * np.minimum(time, 1.0)
    runs = cmf_mj.simulate_many(plant, law, poses, channels=["platform_pose"])
    heave = runs["platform_pose"][:, last, 2]
    basis = np.exp(-2j * np.pi * FREQUENCY * time[last])
    gain = np.abs(heave @ basis) * 2 / last.sum() / amplitudes
    axis.loglog(1000 * amplitudes, gain, ".-", label=law)
axis.set(
    title="Describing function in heave at 3 Hz",
    xlabel="amplitude of the demand [mm]",
    ylabel="gain of the fundamental",
)
figure.legend(loc="outside lower center", ncols=2)
plt.show()
