"""Demand calculations: platform pose demand to leg demand, Eq C.6 (first block of Figure 2-6).

The demand does not depend on feedback, so a whole time history is transformed at once before the
frame loop starts.
"""

import numpy as np
from numpy.typing import NDArray

from cmf_mj import kinematics


def leg_demand(
    pose: NDArray[np.float64], geometry: kinematics.Geometry | None = None
) -> NDArray[np.float64]:
    """Leg demands from neutral [m], (N, 6), of a pose demand (N, 6) [m, rad], z down."""
    return kinematics.pose_to_legs(pose, geometry)
