"""Record, identify, close the loop: a linear model of heave from one run, judged on another.

The model goes from valve command to velocity (ARX structure, output error). Closed with the law it
predicts the bandwidth, which the second run measures.
"""

import cmf_mj
from cmf_mj import signals
from cmf_mj.analysis.identification.continuous import in_field_units, loop_errors, to_continuous
from cmf_mj.analysis.identification.data import experiment
from cmf_mj.analysis.identification.estimation import output_error
from cmf_mj.analysis.identification.model import Orders, simulation_fit

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
model = output_error(first, Orders(4, 3, 1))
print(f"fit on the second run: {float(simulation_fit(model, second)[0]):.1f} %")
velocity = in_field_units(to_continuous(model).rational)
errors = loop_errors(velocity, "velocity", cmf_mj.frequency_response(records[1]))
bandwidth = errors.model.phase_bandwidth_hz
print(f"-90 deg predicted at {bandwidth:.2f} Hz, error {100 * errors.phase_error:.1f} %")
