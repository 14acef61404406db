"""What canals and otoliths make of a motion, and the cueing error of the simulator.

    canals      T1 T2 s^2 (T3 s + 1) / ((T1 s + 1) (T2 s + 1) (T4 s + 1))      of angular rate
    otoliths    K (Ta s + 1) / ((Tl s + 1) (Ts s + 1))                         of specific force

Both have the input's unit. The canals tell rates between about 1 / T1 and 1 / T3 rad/s as they are
and forget a steady one; the otoliths tell a steady specific force by K and a changing one by up to
K Ta / Tl. On samples the inputs run straight between them (`cmf_mj.core.filters`).

Senses of both motions, in flight and in the simulator, are computed alike, and their difference is
compared with the thresholds. A threshold is a setting, not a verdict: whether an error matters
depends on the task.
"""

from pathlib import Path
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from cmf_mj.core.errors import InputError
from cmf_mj.core.filters import discretise, settled_state, write_history
from cmf_mj.core.quantity import Acceleration, AngularSpeed, Ratio, Time, Wait
from cmf_mj.core.settings import Loader, Settings
from cmf_mj.pilot.motion import PilotMotion

QUANTITIES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Specific force along, angular rate about the body axes."""


class Canals(Settings):
    """Semicircular canals."""

    time_constant: Time  #: T1, of cupula and central processing.
    adaptation: Time  #: T2.
    lead: Wait  #: T3; 0 leaves lead and lag out.
    lag: Time  #: T4.


class Otoliths(Settings):
    """Otoliths."""

    gain: Ratio  #: Sensed over true at rest.
    lead: Time
    long_lag: Time
    short_lag: Time


class Thresholds(Settings):
    """Smallest motion noticed, along and about each body axis."""

    x: Acceleration
    y: Acceleration
    z: Acceleration
    roll: AngularSpeed
    pitch: AngularSpeed
    yaw: AngularSpeed

    @property
    def si(self) -> NDArray[np.float64]:
        """Along x, y, z [m/s^2] and about them [rad/s], (6,)."""
        return np.array([getattr(self, name).si for name in QUANTITIES])


class Senses(Settings):
    """All parameters of the senses."""

    canals: Canals
    otoliths: Otoliths
    thresholds: Thresholds

    @model_validator(mode="after")
    def _distinct_time_constants(self) -> "Senses":
        if self.canals.time_constant.si == self.canals.adaptation.si:
            raise InputError("canals.adaptation: must differ from time_constant")
        return self


load_senses = Loader(Senses, Path(__file__).with_suffix(".toml"))
"""Loads the parameters of the senses."""


def canal_response(canals: Canals) -> control.TransferFunction:
    """Transfer function from angular rate to the rate sensed."""
    numerator = np.array([canals.time_constant.si * canals.adaptation.si, 0.0, 0.0])
    denominator = np.polymul([canals.time_constant.si, 1.0], [canals.adaptation.si, 1.0])
    if canals.lead.si == 0.0:
        return control.TransferFunction(numerator, denominator)
    numerator = np.polymul(numerator, [canals.lead.si, 1.0])
    return control.TransferFunction(numerator, np.polymul(denominator, [canals.lag.si, 1.0]))


def otolith_response(otoliths: Otoliths) -> control.TransferFunction:
    """Transfer function from specific force to the specific force sensed."""
    lags = np.polymul([otoliths.long_lag.si, 1.0], [otoliths.short_lag.si, 1.0])
    return control.TransferFunction(otoliths.gain.si * np.array([otoliths.lead.si, 1.0]), lags)


def state_space(response: control.TransferFunction) -> control.StateSpace:
    """Balanced state space of a transfer function with simple poles: its partial fractions."""
    poles = np.sort(np.real(response.poles()))
    numerator, denominator = response.num[0][0], response.den[0][0]
    slope = np.polyval(np.polyder(denominator), poles)
    direct = numerator[0] / denominator[0] if len(numerator) == len(denominator) else 0.0
    residues = np.polyval(np.polysub(numerator, direct * denominator), poles) / slope
    size = np.sqrt(np.abs(residues))
    outputs = (np.sign(residues) * size)[None, :]
    return control.StateSpace(np.diag(poles), size[:, None], outputs, [[direct]])


class Sensed(NamedTuple):
    """What the senses tell, body axes."""

    time: NDArray[np.float64]  #: [s], (N,).
    angular_rate: NDArray[np.float64]  #: By the canals [rad/s], (N, 3).
    specific_force: NDArray[np.float64]  #: By the otoliths [m/s^2], (N, 3).


def sense(motion: PilotMotion, senses: Senses | str | None = None) -> Sensed:
    """What canals and otoliths tell of an evenly sampled motion.

    They start as if the first sample had lasted for a long time: rates forgotten, gravity known.
    """
    loaded = load_senses(senses)
    canals, otoliths = canal_response(loaded.canals), otolith_response(loaded.otoliths)
    rate = _sensed(canals, motion.angular_rate, 1.0 / motion.rate)
    force = _sensed(otoliths, motion.specific_force, 1.0 / motion.rate)
    return Sensed(motion.time, angular_rate=rate, specific_force=force)


def _sensed(
    response: control.TransferFunction, inputs: NDArray[np.float64], interval: float
) -> NDArray[np.float64]:
    """Inputs (N, 3) at samples `interval` [s] apart through a sense, axis by axis, (N, 3)."""
    a, b, c, d = control.ssdata(state_space(response))
    system = discretise(a, b, c, d, interval)
    columns = np.ascontiguousarray(inputs.T)[:, :, None]
    outputs = np.empty_like(columns)
    for column, output in zip(columns, outputs, strict=True):
        write_history(system, settled_state(system, column[0]), column, output)
    return np.ascontiguousarray(outputs[:, :, 0].T)


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


def cueing_error(aircraft: PilotMotion, simulator: PilotMotion) -> CueingError:
    """Compare what is sensed at the pilot's stations of aircraft and simulator, at equal times."""
    if aircraft.time.shape != simulator.time.shape or not np.allclose(
        aircraft.time, simulator.time, rtol=0.0, atol=1e-6
    ):
        raise InputError(
            f"simulator: {simulator.time.size} samples from {simulator.time[0]:.6g} s; the "
            f"aircraft has {aircraft.time.size} from {aircraft.time[0]:.6g} s"
        )
    flight, cab = sense(aircraft), sense(simulator)
    force, rate = flight.specific_force - cab.specific_force, flight.angular_rate - cab.angular_rate
    return CueingError(flight, cab, np.hstack([force, rate]), load_senses().thresholds.si)
