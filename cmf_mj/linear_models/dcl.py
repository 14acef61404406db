"""The digital control law as a linear system: any law, any number of legs, no clamps.

The blocks of `cmf_mj.control` in their linear range: no demand or command clamped, the error
integral engaged and away from its bounds.
"""

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcl import make_dcl
from cmf_mj.control.law import FRAME, SIGNALS, Law, load_law

FEEDBACK = ("leg_position", "leg_velocity", "leg_acceleration", "cap_pressure", "rod_pressure")
"""What a leg's sensors give the DCL [m, m/s, m/s^2, Pa, Pa]."""

DCL_INPUTS = ("reference", *FEEDBACK)
"""Inputs of `dcl_state_space` for each leg; the reference in m."""

_STATES = ("compensator", "error_integral", "error_filter", "reference_filter", "acceleration")


def labels(names: tuple[str, ...], legs: int) -> list[str]:
    """Signal names of all legs, bare for one leg, else `name_1`, `name_2`, name by name."""
    if legs == 1:
        return list(names)
    return [f"{name}_{leg + 1}" for name in names for leg in range(legs)]


def _signals(law: Law) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The compensator's signals as S_x (states) + S_u (inputs), (10, 5) and (10, 6)."""
    dcl = make_dcl(law, 1)
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
    of_inputs[row["position_error_rate"], [column["reference"], column["leg_position"]]] = (
        pole,
        -pole,
    )
    of_states[row["position_error_rate"], state["error_filter"]] = -pole
    of_inputs[row["velocity_error"], [column["reference"], column["leg_velocity"]]] = pole, -1.0
    of_states[row["velocity_error"], state["reference_filter"]] = -pole
    of_states[row["error_integral"], state["error_integral"]] = 1.0
    of_states[row["acceleration"], state["acceleration"]] = 1.0
    area = dcl.feedback.force_area
    of_inputs[row["force"], [column["cap_pressure"], column["rod_pressure"]]] = area, -area
    return of_states, of_inputs


def dcl_state_space(law: str | Law, legs: int = 1) -> control.StateSpace:
    """The DCL without its clamps: discrete at 2048 Hz, the same law for every leg.

    States of each leg: the compensator, and of error integral, derivative filters of error and
    reference and accelerometer filter those that the law uses.

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
    of_states, of_inputs = _signals(loaded)
    gains = dcl.compensator
    a = np.diag([gains.state_gain[0], 1.0, 1.0, 1.0, dcl.feedback.accelerometer_pole])
    b = np.zeros((len(_STATES), len(DCL_INPUTS)))
    a[0] += gains.input_gain[0] @ of_states
    b[0] = gains.input_gain[0] @ of_inputs
    b[1, :2] = FRAME, -FRAME
    a[2, 2] -= FRAME * pole
    b[2, :2] = FRAME * pole, -FRAME * pole
    a[3, 3] -= FRAME * pole
    b[3, 0] = FRAME * pole
    b[4, DCL_INPUTS.index("leg_acceleration")] = dcl.feedback.accelerometer_gain
    c = gains.direct_gain @ of_states
    c[0, 0] += gains.output_gain[0]
    d = gains.direct_gain @ of_inputs
    # A filter drives neither the command nor the compensator unless one of its gains is set.
    kept = [i for i in range(len(_STATES)) if i == 0 or c[0, i] != 0.0 or a[0, i] != 0.0]
    eye = np.eye(legs)
    return control.ss(
        *(np.kron(part, eye) for part in (a[np.ix_(kept, kept)], b[kept], c[:, kept], d)),
        FRAME,
        inputs=labels(DCL_INPUTS, legs),
        outputs=labels(("command",), legs),
        states=labels(tuple(_STATES[i] for i in kept), legs),
        name="DCL",
    )
