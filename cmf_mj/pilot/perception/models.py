"""What canals and otoliths make of a motion, in transfer functions and on samples.

    canals      T1 T2 s^2 (T3 s + 1) / ((T1 s + 1) (T2 s + 1) (T4 s + 1))      of angular rate
    otoliths    K (Ta s + 1) / ((Tl s + 1) (Ts s + 1))                         of specific force

Both have the input's unit. The canals tell rates between about 1 / T1 and 1 / T3 rad/s as they are
and forget a steady one; the otoliths tell a steady specific force by K and a changing one by up to
K Ta / Tl. On samples the inputs run straight between them (`cmf_mj.core.hold`).
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.core.hold import history, hold, settled
from cmf_mj.pilot.motion import PilotMotion
from cmf_mj.pilot.perception.settings import Canals, Otoliths, Senses, load_senses


class Sensed(NamedTuple):
    """What the senses tell, body axes."""

    time: NDArray[np.float64]  #: [s], (N,).
    angular_rate: NDArray[np.float64]  #: By the canals [rad/s], (N, 3).
    specific_force: NDArray[np.float64]  #: By the otoliths [m/s^2], (N, 3).


def canal_response(canals: Canals) -> control.TransferFunction:
    """Transfer function from angular rate to the rate sensed."""
    slow = np.polymul([canals.time_constant.si, 1.0], [canals.adaptation.si, 1.0])
    whole = [canals.time_constant.si * canals.adaptation.si, 0.0, 0.0]
    if canals.lead.si == 0.0:
        return control.TransferFunction(whole, slow)
    return control.TransferFunction(
        np.polymul(whole, [canals.lead.si, 1.0]), np.polymul(slow, [canals.lag.si, 1.0])
    )


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
    return control.StateSpace(
        np.diag(poles), size[:, None], (np.sign(residues) * size)[None, :], [[direct]]
    )


def sense(motion: PilotMotion, senses: Senses | str | None = None) -> Sensed:
    """What canals and otoliths tell of a motion.

    They start as if the first sample had lasted for a long time: rates forgotten, gravity known.

    Args:
        motion: evenly sampled.
        senses: parameters, as `load_senses` takes them.

    Raises:
        InputError: uneven samples or refused parameters.
    """
    loaded = load_senses(senses)
    responses = (canal_response(loaded.canals), otolith_response(loaded.otoliths))
    parts = []
    for response, inputs in zip(
        responses, (motion.angular_rate, motion.specific_force), strict=True
    ):
        model = state_space(response)
        system = hold(model.A, model.B, model.C, model.D, 1.0 / motion.rate)
        outputs = np.empty_like(inputs)
        for axis in range(3):
            column = np.ascontiguousarray(inputs[:, axis : axis + 1])
            sensed = np.empty_like(column)
            history(system, settled(system, column[0]), column, sensed)
            outputs[:, axis] = sensed[:, 0]
        parts.append(outputs)
    return Sensed(motion.time, *parts)
