"""What a law reads of the legs, or of the modes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class LegFeedback(NamedTuple):
    """What the sensors hand to the DCL, every array (n,)."""

    position: NDArray[np.float64]  #: Leg extension from neutral [m].
    velocity: NDArray[np.float64]  #: Leg velocity [m/s].
    acceleration: NDArray[np.float64]  #: Leg acceleration [m/s^2].
    cap_pressure: NDArray[np.float64]  #: Cap pressure [Pa].
    rod_pressure: NDArray[np.float64]  #: Rod pressure [Pa].
