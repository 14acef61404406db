"""The digital control law as a linear system: any law, any number of legs, no clamps.

The blocks of `cmf_mj.control` in their linear range: no demand or command clamped, the error
integral engaged and away from its bounds.
"""

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcl import Dcl, make_dcl
from cmf_mj.control.law import FRAME, SIGNALS, Law, load_law

FEEDBACK = ("leg_position", "leg_velocity", "leg_acceleration", "cap_pressure", "rod_pressure")
"""What a leg's sensors give the DCL [m, m/s, m/s^2, Pa, Pa]."""

DCL_INPUTS = ("reference", *FEEDBACK)
"""Inputs of `dcl_state_space` for each leg; the reference in m."""

_STATES = (
    "compensator",
    "error_integral",
    "error_filter",
    "reference_filter",
    "acceleration",
    "model_position",
    "model_velocity",
)


def labels(names: tuple[str, ...], legs: int) -> list[str]:
    """Signal names of all legs, bare for one leg, else `name_1`, `name_2`, name by name."""
    if legs == 1:
        return list(names)
    return [f"{name}_{leg + 1}" for name in names for leg in range(legs)]


def _target(dcl: Dcl) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What the errors count from, as rows of states and inputs: the demand, or the model."""
    of_states, of_inputs = np.zeros(len(_STATES)), np.zeros(len(DCL_INPUTS))
    if dcl.model.active:
        of_states[_STATES.index("model_position")] = 1.0
    else:
        of_inputs[DCL_INPUTS.index("reference")] = 1.0
    return of_states, of_inputs


def _signals(dcl: Dcl) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The compensator's signals as S_x (states) + S_u (inputs), (10, 7) and (10, 6)."""
    pole = dcl.error.derivative_pole
    of_states = np.zeros((len(SIGNALS), len(_STATES)))
    of_inputs = np.zeros((len(SIGNALS), len(DCL_INPUTS)))
    row = {name: i for i, name in enumerate(SIGNALS)}
    state = {name: i for i, name in enumerate(_STATES)}
    column = {name: i for i, name in enumerate(DCL_INPUTS)}
    for name, source in (
        ("reference", "reference"),
        ("position", "leg_position"),
        ("velocity", "leg_velocity"),
        ("cap_pressure", "cap_pressure"),
        ("rod_pressure", "rod_pressure"),
    ):
        of_inputs[row[name], column[source]] = 1.0
    target_states, target_inputs = _target(dcl)
    for name in ("position_error_rate", "velocity_error"):
        of_states[row[name]] = pole * target_states
        of_inputs[row[name]] = pole * target_inputs
    of_inputs[row["position_error_rate"], column["leg_position"]] = -pole
    of_states[row["position_error_rate"], state["error_filter"]] = -pole
    of_inputs[row["velocity_error"], column["leg_velocity"]] = -1.0
    of_states[row["velocity_error"], state["reference_filter"]] = -pole
    of_states[row["error_integral"], state["error_integral"]] = 1.0
    of_states[row["acceleration"], state["acceleration"]] = 1.0
    area = dcl.feedback.force_area
    of_inputs[row["force"], [column["cap_pressure"], column["rod_pressure"]]] = area, -area
    return of_states, of_inputs


def _model(dcl: Dcl) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The reference model's part of the output as rows of states and inputs, not adapting."""
    model = dcl.model
    of_states, of_inputs = np.zeros(len(_STATES)), np.zeros(len(DCL_INPUTS))
    position, velocity = _STATES.index("model_position"), _STATES.index("model_velocity")
    push = model.acceleration_gain / FRAME
    of_states[position] = model.position_gain + push * model.velocity_of_position
    of_states[velocity] = model.velocity_gain + model.rate_gain
    of_states[velocity] += push * (model.velocity_stays - 1.0)
    of_inputs[DCL_INPUTS.index("reference")] = push * model.velocity_of_reference
    of_inputs[DCL_INPUTS.index("leg_position")] = -model.position_gain
    of_inputs[DCL_INPUTS.index("leg_velocity")] = -model.rate_gain
    return of_states, of_inputs


def dcl_state_space(law: str | Law, legs: int = 1) -> control.StateSpace:
    """The DCL without its clamps: discrete at 2048 Hz, the same law for every leg.

    States of each leg: the compensator, and of error integral, derivative filters of error and
    reference, accelerometer filter and reference model those that the law uses. An adapting law is
    linear while its factor stands still: this is the law with the factor at 1.

    Args:
        law: name, TOML file or loaded law.
        legs: number of legs.

    Returns:
        Inputs `DCL_INPUTS`, output `command` [fraction]; with several legs `reference_1` and so on.

    Raises:
        ValueError: the law is refused, or less than one leg.
    """
    if legs < 1:
        raise ValueError(f"legs: {legs} must be at least 1")
    loaded = load_law(law)
    dcl = make_dcl(loaded, 1)
    pole = dcl.error.derivative_pole
    of_states, of_inputs = _signals(dcl)
    target_states, target_inputs = _target(dcl)
    model_states, model_inputs = _model(dcl)
    gains, model = dcl.compensator, dcl.model
    position = DCL_INPUTS.index("leg_position")
    a = np.diag([gains.state_gain[0], 1.0, 1.0, 1.0, dcl.feedback.accelerometer_pole, 0.0, 0.0])
    b = np.zeros((len(_STATES), len(DCL_INPUTS)))
    a[0] += gains.input_gain[0] @ of_states
    b[0] = gains.input_gain[0] @ of_inputs
    for row, rate in ((1, 1.0), (2, pole), (3, pole)):
        a[row] += FRAME * rate * target_states
        b[row] = FRAME * rate * target_inputs
    b[1:3, position] = -FRAME, -FRAME * pole
    a[2, 2] -= FRAME * pole
    a[3, 3] -= FRAME * pole
    b[4, DCL_INPUTS.index("leg_acceleration")] = dcl.feedback.accelerometer_gain
    a[5, 5:] = model.position_stays, model.position_of_velocity
    a[6, 5:] = model.velocity_of_position, model.velocity_stays
    b[5:, 0] = model.position_of_reference, model.velocity_of_reference
    c = gains.direct_gain @ of_states + model_states
    c[0, 0] += gains.output_gain[0]
    d = gains.direct_gain @ of_inputs + model_inputs
    # A filter drives neither the command nor the compensator unless one of its gains is set.
    used = [i == 0 or c[0, i] != 0.0 or a[0, i] != 0.0 for i in range(5)] + 2 * [model.active]
    kept = np.flatnonzero(used)
    eye = np.eye(legs)
    return control.ss(
        *(np.kron(part, eye) for part in (a[np.ix_(kept, kept)], b[kept], c[:, kept], d)),
        FRAME,
        inputs=labels(DCL_INPUTS, legs),
        outputs=labels(("command",), legs),
        states=labels(tuple(_STATES[i] for i in kept), legs),
        name="DCL",
    )
