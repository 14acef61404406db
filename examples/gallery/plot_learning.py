"""
Can a machine learn a manoeuvre?
================================

Yes: what one run missed corrects the demand of the next. Three waves in heave and pitch under the
law that is flown, five runs; the cab then follows nearly without delay.
"""

import matplotlib.pyplot as plt

import cmf_mj
from cmf_mj import signals
from cmf_mj.facility.host.stream import from_command
from cmf_mj.pilot.learning import learn

heave = signals.sine("heave", 0.08, frequency=0.5, cycles=3)
pitch = signals.sine("pitch", 0.05, frequency=0.5, cycles=3)
both = signals.Command.from_pose(heave.pose + pitch.pose)
learnt = learn(from_command(both), "velocity", [cmf_mj.Hexapod(cab="gfd")], trials=4)

figure, (upper, lower) = plt.subplots(2, 1, layout="constrained")
asked = learnt.reference.pose[-len(learnt.errors[0]) :, 2]
time = learnt.reference.time[-asked.size :]
upper.plot(time, 1000 * asked, color="0.7", linewidth=4, label="asked")
for run, error in zip(("first run", "last run"), learnt.errors, strict=True):
    upper.plot(time, 1000 * (asked - error[:, 2]), label=run)
upper.set(xlabel="time [s]", ylabel="heave [mm]", title="A manoeuvre, learnt in four trials")
lower.semilogy([1000 * trial.legs for trial in learnt.trials], "o-", label="simulated")
lower.semilogy([1000 * trial.predicted for trial in learnt.trials], "x--", label="linear")
lower.set(xlabel="trial", ylabel="error of the legs [mm]", xticks=range(5))
for axis in (upper, lower):
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
plt.show()
