"""A law of your own, from a dictionary, in all six degrees of freedom beside the law flown.

The same tables in a TOML file work everywhere a law's name does:
`cmf compare --laws velocity,my_law.toml`. `laws.toml` lists the signals and their units.
"""

import numpy as np

import cmf_mj
from cmf_mj import signals

softer = cmf_mj.load_law(
    {
        "title": "Velocity feedback with less gain",
        "state_gain": 0.914,
        "output_gain": -37.1759,
        "input_gain": {"position": 1.0},
        "direct_gain": {"reference": 40.0, "position": 390.0, "velocity": -2.6},
    }
)
plant = cmf_mj.Hexapod(cab="gfd")
for dof in ("surge", "sway", "heave", "roll", "pitch", "yaw"):
    size = 0.33 * 0.0254 if dof in ("surge", "sway", "heave") else np.radians(0.2)
    sweep = signals.multisine(dof, size, periods=2)
    for law in ("velocity", softer):
        response = cmf_mj.frequency_response(cmf_mj.simulate(plant, law, sweep), dof=dof)
        bandwidth = cmf_mj.bandwidths(response).phase_hz
        name = law if isinstance(law, str) else law.title
        print(f"{dof:6} {name:34} -90 deg at {bandwidth:.2f} Hz")
