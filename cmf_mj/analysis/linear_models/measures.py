"""Bandwidths, step and damping of a linear loop, and Table 4-1 from the report's models.

A damping ratio is read in three ways, which agree for a second-order system without static error:

    step     the overshoot over the final value, as everywhere in this project
    demand   the overshoot over the demanded step, smaller where a law stops short of it
    peak     the largest gain over absolute 0 dB, M = 1 / (2 z sqrt(1 - z^2))

The report uses `step` (overshoots of 15, 7 and 23 % are 0.5, 0.6 and 0.4) and, for force feedback,
`peak` (1 dB is 0.5). It does not say which one Table 4-1 has.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import bandwidths
from cmf_mj.analysis.linear_models.catalogue import HARDWARE_MODELS, hardware_velocity
from cmf_mj.analysis.linear_models.loop import closed_loop, loop_response
from cmf_mj.analysis.published import published_results
from cmf_mj.analysis.step_response import damping_from_overshoot, resonant_damping, step_shape
from cmf_mj.core.rates import FRAME

STEP_DURATION = 10.0
"""Length of the steps measured [s]."""

FREQUENCIES = np.linspace(0.02, 20.0, 4000)
"""Lines the bandwidths are read from [Hz]."""

_AT_REST = 1e-9
"""How near the unit circle a pole counts as on it."""


_OSCILLATING = 0.9
"""Damping ratio below which a pair counts as oscillating; above, it may be two equal real poles."""


class LoopMeasures(NamedTuple):
    """Measures of a closed loop; NaN where it has no such thing, of a step also where unstable."""

    stable: bool  #: Whether all poles lie within the unit circle.
    phase_bandwidth_hz: float  #: First fall of the phase through -90 deg [Hz].
    gain_bandwidth_hz: float  #: First fall of the gain through -3 dB, from absolute 0 dB [Hz].
    peak_gain_db: float  #: Largest gain [dB].
    static_gain: float  #: Gain at rest.
    overshoot: float  #: Of a step, over its final value.
    step_damping_ratio: float  #: From the overshoot over the final value.
    demand_damping_ratio: float  #: From the overshoot over the demanded step.
    peak_damping_ratio: float  #: From the largest gain over absolute 0 dB.
    mode_damping_ratio: float  #: Of the slowest pair of poles with a damping ratio below 0.9.
    mode_frequency_hz: float  #: Modulus of that pair [Hz].
    rise_time: float  #: 10 to 90 % [s].
    settling_time: float  #: Into 2 % of the final value [s].


def step_response(
    loop: control.StateSpace, duration: float = STEP_DURATION, output: int = 0, input: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time [s] and response to a unit step at 2048 Hz, both (N,)."""
    time = np.arange(round(duration / FRAME)) * FRAME
    found = control.step_response(loop, time, input=input, output=output)
    return np.asarray(time, dtype=np.float64), np.asarray(found.outputs).reshape(-1)


def measure_loop(loop: control.StateSpace, output: int = 0, input: int = 0) -> LoopMeasures:
    """Measure a closed loop from one reference to one output.

    Args:
        loop: of `closed_loop`.
        output: index of the output.
        input: index of the input.
    """
    response = loop_response(loop, FREQUENCIES, output, input)
    widths = bandwidths(response)
    nan = float("nan")
    poles = np.asarray(loop.poles(), dtype=complex)
    stable = bool(np.all(np.abs(poles) < 1.0 - _AT_REST))
    modes = np.log(poles[poles.imag > 0.0]) / FRAME
    modes = modes[-modes.real < _OSCILLATING * np.abs(modes)]
    slow = modes[np.argmin(np.abs(modes))] if modes.size else complex(nan, nan)
    static, over, step, demand, rise, settle = (nan,) * 6
    if stable:
        static = float(np.real(np.atleast_2d(control.dcgain(loop))[output, input]))
        _, reached = step_response(loop, output=output, input=input)
        over, step, rise, settle = step_shape(reached / static, 1.0 / FRAME)
        demand = damping_from_overshoot(float(reached.max()) - 1.0)
    return LoopMeasures(
        stable=stable,
        phase_bandwidth_hz=widths.phase_hz,
        gain_bandwidth_hz=widths.gain_hz,
        peak_gain_db=widths.peak_db,
        static_gain=static,
        overshoot=over,
        step_damping_ratio=step,
        demand_damping_ratio=demand,
        peak_damping_ratio=resonant_damping(10.0 ** (widths.peak_db / 20.0)) if stable else nan,
        mode_damping_ratio=float(-slow.real / np.abs(slow)),
        mode_frequency_hz=float(np.abs(slow) / (2.0 * np.pi)),
        rise_time=rise,
        settling_time=settle,
    )


BANDWIDTH_TOLERANCE, DAMPING_TOLERANCE = 0.03, 0.1
"""Deviations from Table 4-1 [Hz and 1] that count as agreement."""


class TableRow(NamedTuple):
    """One entry of Table 4-1 beside the computed one."""

    model: int  #: Linear model 1 to 3.
    equation: str  #: Of its velocity transfer function.
    quantity: str  #: `-90 deg`, `-3 dB`, or `damping` with its reading.
    unit: str
    published: float
    computed: float
    deviation: float  #: Computed minus published.
    tolerance: float  #: Largest deviation that counts as within.
    within: bool


def table_4_1() -> tuple[TableRow, ...]:
    """Table 4-1 computed: the velocity law around linear models 1 to 3, beside the print.

    The damping ratio stands in all three readings.
    """
    rows = []
    printed = {str(row.of): row for row in published_results() if row.table == "4-1"}
    for number, equation in HARDWARE_MODELS.items():
        found = measure_loop(closed_loop("velocity", hardware_velocity(number)))
        beside = printed[f"linear_{number}"]
        entries = [
            ("-90 deg", "Hz", beside.phase_bandwidth_hz, found.phase_bandwidth_hz),
            ("-3 dB", "Hz", beside.gain_bandwidth_hz, found.gain_bandwidth_hz),
            ("damping, step", "1", beside.damping_ratio, found.step_damping_ratio),
            ("damping, demand", "1", beside.damping_ratio, found.demand_damping_ratio),
            ("damping, peak", "1", beside.damping_ratio, found.peak_damping_ratio),
        ]
        for quantity, unit, published, computed in entries:
            stated = float("nan") if published is None else published
            tolerance = BANDWIDTH_TOLERANCE if unit == "Hz" else DAMPING_TOLERANCE
            off = computed - stated
            rows.append(
                TableRow(
                    number,
                    equation,
                    quantity,
                    unit,
                    stated,
                    computed,
                    off,
                    tolerance,
                    abs(off) <= tolerance,
                )
            )
    return tuple(rows)
