"""
Does the linear model agree with the simulation?
================================================

`linearize` takes the slopes of the plant at rest. Its closed loop and the simulated multisine
agree in small motion, lines for curves, in the slowest axis and in a fast one.
"""

import matplotlib.pyplot as plt
import numpy as np

import cmf_mj
from cmf_mj import signals
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.machine.geometry import DOFS
from cmf_mj.show.look import frequency_axis

plant = cmf_mj.Hexapod(cab="gfd")
loop = cmf_mj.Linear(plant).loop("velocity")
frequency = np.geomspace(0.1, 10.0, 200)
figure, (gain, phase) = plt.subplots(2, sharex=True, layout="constrained")
for dof, colour in (("surge", "tab:blue"), ("heave", "tab:orange")):
    index = DOFS.index(dof)
    line = loop_response(loop[index, index], frequency)
    sweep = signals.multisine(dof, 0.1 * 0.0254, periods=2)
    measured = cmf_mj.frequency_response(cmf_mj.simulate(plant, "velocity", sweep), dof=dof)
    gain.plot(line.frequency, line.gain_db, color=colour, label=f"{dof}, linear")
    gain.plot(measured.frequency, measured.gain_db, ".", color=colour, label=f"{dof}, simulated")
    phase.plot(line.frequency, line.phase_deg, color=colour)
    phase.plot(measured.frequency, measured.phase_deg, ".", color=colour)
gain.set(title="Velocity feedback, 0.1 in", ylabel="gain [dB]", ylim=(-25, 15))
phase.set(ylabel="phase [deg]", ylim=(-270, 10))
frequency_axis(phase.xaxis)
figure.legend(loc="outside lower center", ncols=2)
plt.show()
