"""
What does a law that adapts make of slow and fast legs?
=======================================================

A sine in heave on single legs 30 % slow, nominal and 30 % fast. The fixed law feeds forward for
nominal legs; the adaptive one finds the factor that its legs lack, the dashed lines.
"""

import matplotlib.pyplot as plt

import cmf_mj
from cmf_mj import signals
from cmf_mj.facility.replay import replay

parameters = cmf_mj.load_hydraulics("hardware")
speed = parameters.leg_speed
command = signals.sine("heave", 2.0 * 0.0254, 0.4, cycles=4.0)
figure, (factor, error) = plt.subplots(2, 1, sharex=True, layout="constrained")
for colour, share in zip(("C0", "C1", "C2"), (0.7, 1.0, 1.3), strict=True):
    other = speed.model_copy(update={"value": share * speed.value})
    plant = cmf_mj.SingleLegs(parameters.model_copy(update={"leg_speed": other}))
    for name, line in (("model_following", ":"), ("model_reference_adaptive", "-")):
        record = cmf_mj.simulate(plant, name, command)
        factor.plot(record.time, replay(record, name).factor[:, 0], colour + line)
        missed = (record["leg_reference"] - record["leg_position"])[:, 0] / 0.0254
        error.plot(record.time, missed, colour + line, label=f"speed {share:g}, {name}")
    factor.axhline(1.0 / share, color=colour, linewidth=0.6, linestyle="--")
factor.set(title="Feed-forward and error of leg 1, heave sine of 2 in at 0.4 Hz", ylabel="factor")
error.set(xlabel="time [s]", ylabel="demand less position [in]")
figure.legend(loc="outside lower center", ncols=2, fontsize=8)
plt.show()
