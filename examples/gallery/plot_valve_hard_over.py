"""
A valve goes hard over
======================

Both valves of leg 1 open fully at 2 s, while the cab moves in heave. The tracking error is found
within a fraction of a second (dotted), and the emergency stop lets the machine down slowly.
"""

import matplotlib.pyplot as plt

from cmf_mj.plant.events import default_event
from cmf_mj.studies.failure import run_failure

result = run_failure(default_event("valve_hard_over", 2.0), after=6.0)
record = result.record
figure, (top, bottom) = plt.subplots(2, sharex=True, layout="constrained")
for leg in range(6):
    top.plot(record.time, 1000 * record["leg_extension"][:, leg], label=f"leg {leg + 1}")
top.set(
    title=f"Valve hard over, found by its {result.detected_by.replace('_', ' ')}",
    ylabel="extension [mm]",
)
names = ("forward", "left", "up")
bottom.plot(record.time, record["crew_acceleration"] / 9.80665, label=names)
bottom.set(xlabel="time [s]", ylabel="crew acceleration [g]")
for axis in (top, bottom):
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    axis.axvline(2.0, color="tab:red", linewidth=0.8)
    axis.axvline(2.0 + result.detection_time, color="tab:red", linestyle=":", linewidth=0.8)
plt.show()
