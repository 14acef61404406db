"""
How fast are two laws in surge?
===============================

The report's velocity feedback, and a law that knows the machine's hydraulic modes. Both follow the
same multisine of 0.1 in; the dots are its lines. At 0.33 in the lines of the second law scatter.
"""

import matplotlib.pyplot as plt

import cmf_mj
from cmf_mj import signals
from cmf_mj.show.look import frequency_axis

plant = cmf_mj.Hexapod(cab="gfd")
sweep = signals.multisine("surge", 0.1 * 0.0254, periods=2)
figure, (gain, phase) = plt.subplots(2, sharex=True, layout="constrained")
for law in ("velocity", "modal_plan"):
    response = cmf_mj.frequency_response(cmf_mj.simulate(plant, law, sweep), dof="surge")
    found = cmf_mj.bandwidths(response)
    label = f"{law}: {found.phase_hz:.1f} Hz at -90 deg"
    gain.plot(response.frequency, response.gain_db, ".-", label=label)
    phase.plot(response.frequency, response.phase_deg, ".-")
gain.set(title="Surge demand to surge, 0.1 in, GFD", ylabel="gain [dB]", ylim=(-30, 15))
phase.set(ylabel="phase [deg]", ylim=(-270, 10))
phase.axhline(-90.0, color="0.5", linewidth=0.8)
frequency_axis(phase.xaxis)
figure.legend(loc="outside lower center", ncols=2)
plt.show()
