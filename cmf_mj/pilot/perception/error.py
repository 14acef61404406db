"""Cueing error: what the pilot would sense in flight, less what he senses in the simulator.

Canals and otoliths of both motions are computed alike, and their difference is compared with the
thresholds. A threshold is a setting, not a verdict: whether an error matters depends on the task.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.core.errors import InputError
from cmf_mj.core.units import STANDARD_GRAVITY
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception.models import Sensed, otolith_response, sense
from cmf_mj.pilot.perception.settings import Senses, load_senses

QUANTITIES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Specific force along, angular rate about the body axes."""


class CueingError(NamedTuple):
    """Senses of both motions and their difference."""

    aircraft: Sensed
    simulator: Sensed
    error: NDArray[np.float64]
    """Aircraft less simulator: specific force [m/s^2] and angular rate [rad/s], (N, 6)."""
    threshold: NDArray[np.float64]  #: In the same units, (6,).

    @property
    def peak(self) -> NDArray[np.float64]:
        """Largest magnitudes, (6,)."""
        return np.asarray(np.abs(self.error).max(axis=0))

    @property
    def rms(self) -> NDArray[np.float64]:
        """Root mean squares, (6,)."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))

    @property
    def share_above(self) -> NDArray[np.float64]:
        """Share of the time above the threshold, (6,)."""
        return np.asarray(np.mean(np.abs(self.error) > self.threshold, axis=0))


def cueing_error(
    aircraft: PilotMotion, simulator: PilotMotion, senses: Senses | str | None = None
) -> CueingError:
    """Compare what is sensed at the pilot's station of the aircraft and of the simulator.

    Args:
        aircraft: motion in flight.
        simulator: motion in the simulator, at the same times.
        senses: parameters, as `load_senses` takes them.

    Raises:
        InputError: different times.
    """
    if aircraft.time.shape != simulator.time.shape or not np.allclose(
        aircraft.time, simulator.time, rtol=0.0, atol=1e-6
    ):
        raise InputError(
            f"simulator: {simulator.time.size} samples from {simulator.time[0]:.6g} s; the "
            f"aircraft has {aircraft.time.size} from {aircraft.time[0]:.6g} s"
        )
    loaded = load_senses(senses)
    flown, felt = sense(aircraft, loaded), sense(simulator, loaded)
    error = np.hstack(
        [flown.specific_force - felt.specific_force, flown.angular_rate - felt.angular_rate]
    )
    thresholds = loaded.thresholds
    return CueingError(
        flown, felt, error, np.concatenate([thresholds.specific_force, thresholds.angular_rate])
    )


class Oscillation(NamedTuple):
    """A sine of specific force before the otoliths and the thresholds; arrays over frequency."""

    frequency: NDArray[np.float64]  #: [Hz], (K,).
    amplitude: float  #: [m/s^2].
    sensed: NDArray[np.float64]  #: Amplitude of what the otoliths tell [m/s^2], (K,).
    over_threshold: NDArray[np.float64]  #: `sensed` over the thresholds along x, y, z, (K, 3).
    input_over_threshold: NDArray[np.float64]
    """`amplitude` over them, (3,): the threshold read as one of the true specific force."""


def oscillation(
    amplitude: float = 0.1 * STANDARD_GRAVITY,
    frequency: ArrayLike = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0),
    senses: Senses | str | None = None,
) -> Oscillation:
    """What the otoliths make of a sine of specific force, with the thresholds.

    Args:
        amplitude: of the sine [m/s^2].
        frequency: [Hz], (K,).
        senses: parameters, as `load_senses` takes them.
    """
    loaded = load_senses(senses)
    hertz = np.atleast_1d(np.asarray(frequency, dtype=float))
    gain = np.abs(_at(otolith_response(loaded.otoliths), hertz))
    limits = loaded.thresholds.specific_force
    return Oscillation(
        hertz, amplitude, amplitude * gain, amplitude * gain[:, None] / limits, amplitude / limits
    )


def _at(response: control.TransferFunction, hertz: NDArray[np.float64]) -> NDArray[np.complex128]:
    return np.asarray(response(2j * np.pi * hertz))
