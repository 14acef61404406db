"""Why a law around a leg oscillates: the least damped poles and the phase crossover of its loop.

The loop broken at the valve command, with leg plant P and DCL C in discrete time,

    L(f) = C(e^(2 pi i f T)) P(e^(2 pi i f T)) e^(-2 pi i f T),

oscillates where the phase of L is a whole turn. A command clamped at 100 % lowers the gain and
leaves the phase: a limit cycle ends up between the frequency of the unstable poles and this one.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.law import DCL_INPUTS, FEEDBACK, dcl_state_space
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.reduction import leg_model
from cmf_mj.analysis.measures import least_damped_mode
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.record.record import Record

_FREQUENCY = np.geomspace(2.0, 100.0, 4000)
_TAIL = 4.0
"""Length of the steady oscillation examined [s]."""


class Oscillation(NamedTuple):
    """What the linear loop says; NaN where it has no such thing."""

    pole_hz: float  #: Modulus of the least damped pair.
    pole_damping: float  #: Its damping ratio, negative where it grows.
    crossover_hz: float
    """Where the phase of the open loop is a whole turn, at the highest gain there."""
    crossover_gain: float  #: Of the open loop there; above 1 the loop oscillates.


def open_loop(law: Law, leg: control.StateSpace, f: NDArray[np.float64]) -> NDArray[np.complex128]:
    """L at `f` [Hz], (K,): from the command at the valve around to the DCL's output."""
    omega = 2.0 * np.pi * f
    sampled = control.sample_system(leg, law.frame, method="zoh", copy_names=True)
    plant = control.frequency_response(sampled, omega).frdata[:, 0, :]
    dcl = control.frequency_response(dcl_state_space(law), omega).frdata[0]
    rows = {name: plant[sampled.output_labels.index(name)] for name in FEEDBACK}
    total = sum(dcl[DCL_INPUTS.index(name)] * rows[name] for name in FEEDBACK)
    return np.asarray(total * np.exp(-1j * omega * law.frame))


def oscillation(law: Law, parameters: HydraulicParameters) -> Oscillation:
    """Least damped poles and phase crossover of one leg under a law."""
    leg = leg_model(linearize(SingleLegs(parameters)), 1)
    # Slower pairs belong to the law's integrator, not to an oscillation.
    damping, frequency = least_damped_mode(
        closed_loop(law, leg).poles(), 200.0, lowest_hz=4.0, frame=law.frame
    )
    loop = open_loop(law, leg, _FREQUENCY)
    turns = np.flatnonzero((loop.imag[1:] * loop.imag[:-1] < 0.0) & (loop.real[1:] > 0.0))
    crossover, gain = float("nan"), float("nan")
    if turns.size:
        at = turns[np.argmax(np.abs(loop[turns]))]
        crossover, gain = float(_FREQUENCY[at]), float(np.abs(loop[at]))
    return Oscillation(frequency, damping, crossover, gain)


def limit_cycle(record: Record) -> tuple[float, float, float]:
    """Frequency [Hz], amplitude [psi] and largest acceleration [g] of leg 1 at the end of a run.

    The frequency is NaN where the oscillation has died down.
    """
    tail = round(_TAIL * record.rate)
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[-tail:, 0])
    acceleration = float(np.abs(record["leg_acceleration"][-tail:, 0]).max())
    acceleration /= units.STANDARD_GRAVITY
    swing = difference - difference.mean()
    amplitude = float(np.ptp(swing)) / 2.0
    if amplitude < 10.0:
        return float("nan"), amplitude, acceleration
    spectrum = np.abs(np.fft.rfft(swing * np.hanning(tail)))
    return float(np.argmax(spectrum) / _TAIL), amplitude, acceleration
