"""Record, identify, close the loop: a linear model of heave from one run, judged on another.

The model goes from valve command to velocity (ARX). Closed with the law it
predicts the bandwidth, which the second run measures.
"""

import cmf_mj
from cmf_mj import signals
from cmf_mj.analysis.identification import (
    arx,
    experiment,
    fit_percentage,
    simulated,
    to_continuous,
)
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.measures import measure_loop

INCH = 0.0254

records = [
    cmf_mj.simulate(
        cmf_mj.Hexapod(),
        "velocity",
        signals.multisine(
            "heave", 0.33 * INCH, stop=16.0, spectrum="acceleration", fade=1.0, seed=seed
        ),
        record_every=16,
    )
    for seed in (0, 1)
]
first, second = (experiment(record, "heave") for record in records)
model = arx([first], (4, 3, 1))
print(f"fit on the second run: {fit_percentage(second.output, simulated(model, second)):.1f} %")
predicted = measure_loop(closed_loop("velocity", to_continuous(model).velocity)).phase_bandwidth_hz
measured = cmf_mj.bandwidths(cmf_mj.frequency_response(records[1])).phase_hz
error = 100.0 * (predicted / measured - 1.0)
print(f"-90 deg predicted at {predicted:.2f} Hz, error {error:.1f} %")
