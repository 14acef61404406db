"""What compares laws, not machines: bandwidth over what the machine gives, forces, noise.

Over the corner of the servo drive's lag, over the lowest hydraulic mode with the valves shut, over
where unit gain at that amplitude ends, `Asymptotes.saturation`. Stiffness and rejection are those
of `Linear.disturbance`. Noise to the valve is the rms of the busiest valve's
command, less its mean, in two seconds of rest behind noisy electronics.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.linear.binding import bound
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import NotLinearError
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.facility.run import simulate
from cmf_mj.machine.dof import dof_index
from cmf_mj.plant.hexapod import oil_modes
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.capacity.asymptotes import asymptotes


class Qualities(NamedTuple):
    """What compares laws along one axis, at neutral; NaN where unstable or not to be had."""

    over_drive_lag: float
    over_oil_mode: float
    of_saturation: float
    static_stiffness: float  #: [N/m, N m/rad]; infinite where a force leaves no motion.
    dynamic_stiffness: float  #: Least from 0.5 to 5 Hz [N/m, N m/rad].
    rejection_hz: float  #: Disturbance rejection bandwidth [Hz].
    rejection_peak_db: float  #: Its peak [dB].
    valve_noise: float  #: Fraction of full command.


def qualities(plant: Plant, law: Law, swept: Sequence[tuple[str, float, float]]) -> list[Qualities]:
    """Qualities of a law on a plant along axes that were swept.

    `swept` holds of each its name, amplitude [m or rad] and -90 deg bandwidth [Hz], NaN where
    unstable. What has no linearisation has neither stiffness nor rejection.
    """
    held, rate = bound(law, plant), plant.machine.rate
    stable = not np.isnan([phase for *_, phase in swept]).all()
    still, noise = np.zeros((3 * rate, 6)), float("nan")
    if stable:
        rest = simulate(plant, held, still, electronics=ElectronicsSettings())
        noise = float(rest["valve_command"][rate:].std(axis=0).max())
    try:
        force = Linear(plant).disturbance(held)
    except NotLinearError:
        force = np.full((4, 6), np.nan)
    found = []
    for dof, amplitude, phase in swept:
        limits = asymptotes(plant, dof)
        mode = oil_modes(limits.mass, limits.stiffness)[0][0]
        over = [units.from_si("Hz", rate) for rate in (limits.corners[0], mode)]
        shares = (phase / end for end in (*over, limits.saturation(amplitude)))
        found.append(Qualities(*map(float, (*shares, *force[:, dof_index(dof)], noise))))
    return found
