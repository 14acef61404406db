"""
Is the machine linear?
======================

No: a valve command ends at 100 %. Eighty runs side by side give the gain at 3 Hz; it falls from the
amplitude on at which the law asks for more.
"""

import matplotlib.pyplot as plt
import numpy as np
from joblib import Parallel, delayed

import cmf_mj

FREQUENCY, SECONDS, RATE = 3.0, 3.0, 2048
time = np.arange(round(SECONDS * RATE)) / RATE
sine = np.sin(2 * np.pi * FREQUENCY * time)
amplitudes = np.geomspace(0.0005, 0.06, 40)
last = time >= SECONDS - 2 / FREQUENCY
figure, axis = plt.subplots(layout="constrained")
basis = np.exp(-2j * np.pi * FREQUENCY * time[last])


def heave_of(law: str, amplitude: float) -> np.ndarray:
    """Heave of a plant of its own in the last two periods."""
    pose = np.zeros((time.size, 6))
    pose[:, 2] = amplitude * sine * np.minimum(time, 1.0)
    return cmf_mj.simulate(cmf_mj.Hexapod(cab="gfd"), law, pose)["platform_pose"][last, 2]


many = Parallel(n_jobs=-1, backend="threading")
for law in ("velocity", "position_error_rate"):
    heave = np.array(many(delayed(heave_of)(law, amplitude) for amplitude in amplitudes))
    gain = np.abs(heave @ basis) * 2 / last.sum() / amplitudes
    axis.loglog(1000 * amplitudes, gain, ".-", label=law)
axis.set(
    title="Describing function in heave at 3 Hz",
    xlabel="amplitude of the demand [mm]",
    ylabel="gain of the fundamental",
)
figure.legend(loc="outside lower center", ncols=2)
plt.show()
