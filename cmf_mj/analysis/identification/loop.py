"""Identified models closed with the law, and their errors against the measured loop (Table 4-1).

A model of leg velocity per command is closed as in Figure 4-5: position by integration, pressures
zero. `linear.loop.closed_loop` does so for one continuous transfer function. For several axes,
and for models that are a response only, `closed_loop_response` solves the loop line by line,

    T = H V / s (1 - H (C_p V / s + C_v V + C_a V s e^(-s T0) + C_cap P_cap + C_rod P_rod))^-1 C_r

with s = j w, C the DCL at z = e^(s T0), T0 = 1/2048 s, V and P the matrices from commands to
velocities and pressures and H = e^(-s d T0) (1 - e^(-s T0)) / (s T0) delay and hold. The same law
on every axis is a number times 1, and the axes may be any; a law in hydraulic modes is a matrix.
The accelerometer is one frame late, as in the simulation.

The report's zero pressures are nearly right for a leg of its own and in heave, where the law's
pressure terms move the -90 deg bandwidth by 0.3 %. In surge and sway of the hexapod, whose legs
swing the largest mass, they slow it by about 2 %: models of the pressures belong into that loop.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike

from cmf_mj.analysis.frequency_response import Bandwidths, FrequencyResponse, bandwidths
from cmf_mj.analysis.identification.data import Real
from cmf_mj.analysis.identification.model import Complex
from cmf_mj.analysis.linear.law import DCL_INPUTS, dcl_state_space
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.transfer import UnitTransferFunction
from cmf_mj.analysis.step_response import StepMetrics, damping_from_overshoot
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME

STEP_TIME = 12.0
"""Length of a model's step response [s], that of the shipped step after its start."""


def closed_loop_response(
    law: str | Law,
    velocity: ArrayLike,
    frequency: ArrayLike,
    *,
    pressures: tuple[ArrayLike, ArrayLike] | None = None,
    command_delay: int = 1,
    legs_of_axes: ArrayLike | None = None,
) -> Complex:
    """Response (K, n, n) from leg or axis references to positions with a law around a plant.

    Args:
        law: name, TOML file or loaded law; one in hydraulic modes must be `mounted`.
        velocity: plant response from commands at the valves to velocities, (K, n, n) or (K,)
            [m/s per full command]: with neither computing delay nor hold, as `experiment` gives it.
        frequency: lines [Hz], (K,), above 0.
        pressures: responses to cap and rod pressures likewise [Pa per full command]; default zero.
        command_delay: frames from the DCL to the valves.
        legs_of_axes: legs of a unit along each axis, (n, n), for a law in hydraulic modes; default
            axes that are the legs.

    Raises:
        InputError: shapes that do not match, a line at 0 Hz, a refused law.
    """
    f = np.asarray(frequency, dtype=float)
    if not (f > 0.0).all():
        raise InputError("frequency: must be greater than 0 at every line")
    v = _square("velocity", velocity, f.size)
    s = 2j * np.pi * f[:, None, None]
    turn = np.eye(v.shape[1]) if legs_of_axes is None else np.asarray(legs_of_axes, dtype=float)
    gain = _law_gains(load_law(law), f, turn)
    held = (1.0 - np.exp(-s * FRAME)) / (s * FRAME) * np.exp(-s * FRAME * command_delay)
    late = s * np.exp(-s * FRAME)
    back = (gain["leg_position"] / s + gain["leg_velocity"] + gain["leg_acceleration"] * late) @ v
    if pressures is not None:
        for name, values in zip(("cap_pressure", "rod_pressure"), pressures, strict=True):
            back = back + gain[name] @ _square(name, values, f.size)
    command = np.linalg.solve(np.eye(v.shape[1]) - held * back, gain["reference"])
    return np.asarray(held / s * v @ command)


def _law_gains(law: Law, frequency: Real, legs_of_axes: Real) -> dict[str, Complex]:
    """Responses of the DCL along axes from each of its inputs to the command, (K, n, n) each."""
    axes = legs_of_axes.shape[0]
    coupled = law.coordinates != "legs"
    system = dcl_state_space(law, axes if coupled else 1)
    rows = control.frequency_response(system, 2.0 * np.pi * frequency).frdata
    if coupled:
        inverse = np.linalg.inv(legs_of_axes)
        by_leg = np.split(np.moveaxis(rows, -1, 0), len(DCL_INPUTS), axis=2)
        parts = [np.asarray(inverse @ part @ legs_of_axes, dtype=complex) for part in by_leg]
    else:
        parts = [row[:, None, None] * np.eye(axes) for row in rows[0]]
    return dict(zip(DCL_INPUTS, parts, strict=True))


def _square(name: str, values: ArrayLike, lines: int) -> Complex:
    response = np.asarray(values, dtype=complex)
    response = response[:, None, None] if response.ndim == 1 else response
    if response.ndim != 3 or response.shape[0] != lines or response.shape[1] != response.shape[2]:
        raise InputError(
            f"{name}: shape is {np.shape(values)}; allowed: ({lines}, n, n) or ({lines},)"
        )
    return response


class LoopErrors(NamedTuple):
    """A model's closed loop beside the measured one, in the terms of Table 4-1."""

    model: Bandwidths
    measured: Bandwidths
    overshoot: float  #: Of the model's step, fraction; NaN without a measured step.
    damping_ratio: float  #: Of the model's step, from its overshoot.
    rise_time: float  #: Of the model's step, 10 to 90 % [s].
    step: StepMetrics | None  #: The measured step.

    @property
    def phase_error(self) -> float:
        """Relative error of the -90 deg bandwidth, positive where the model is faster."""
        return self.model.phase_hz / self.measured.phase_hz - 1.0

    @property
    def gain_error(self) -> float:
        """Relative error of the -3 dB bandwidth."""
        return self.model.gain_hz / self.measured.gain_hz - 1.0


def loop_errors(
    velocity: UnitTransferFunction,
    law: str | Law,
    measured: FrequencyResponse,
    step: StepMetrics | None = None,
    *,
    command_delay: int = 1,
) -> LoopErrors:
    """Close a velocity model with the law and compare it with the measured closed loop.

    Args:
        velocity: leg velocity per command, continuous [in/s per %]; see `in_field_units`.
        law: the law of the measurement.
        measured: its response from reference to position, `frequency_response`.
        step: its measured step.
        command_delay: frames from the DCL to the valves.

    Raises:
        InputError: a refused law or delay.
    """
    loop = closed_loop(law, velocity, command_delay=command_delay)
    found = bandwidths(control.frequency_response(loop, measured.omega))
    nan = float("nan")
    shape = (nan, nan, nan)
    if step is not None:
        shape = _step_shape(loop)
    return LoopErrors(found, bandwidths(measured), *shape, step)


def _step_shape(loop: control.StateSpace) -> tuple[float, float, float]:
    """Overshoot, damping ratio and rise time of the loop's unit step; NaN if it is unstable."""
    if np.abs(np.linalg.eigvals(loop.A)).max() > 1.0 + 1e-6:
        return float("nan"), float("nan"), float("nan")
    time = np.arange(0.0, STEP_TIME, FRAME)
    output: Real = np.asarray(control.step_response(loop, time).outputs)
    tail = round(1.0 / FRAME)
    shape = output / output[-tail:].mean()
    overshoot = float(shape.max() - 1.0)
    rise = (int(np.argmax(shape >= 0.9)) - int(np.argmax(shape >= 0.1))) * FRAME
    return overshoot, damping_from_overshoot(overshoot), rise


def axis_bandwidths(response: Complex, frequency: ArrayLike, axis: int) -> Bandwidths:
    """Bandwidths of a diagonal element of a response matrix (K, n, n) at `frequency` [Hz]."""
    omega = 2.0 * np.pi * np.asarray(frequency, dtype=float)
    return bandwidths(control.FrequencyResponseData(response[:, axis, axis], omega))
