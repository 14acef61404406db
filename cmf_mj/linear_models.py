"""Linear models: the report's hardware fits, the DCL as a linear system, and both in a loop.

The report fitted the velocity response of the hardware to the compensator command (Eqs 4.12, 4.15,
4.18, in in/s per per cent) and closed the loop around it with the position integrated from the
velocity and the pressures set to zero (Figure 4-5). `closed_loop` does the same for any law.
"""

import control
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from cmf_mj import units
from cmf_mj.control.dcl import make_dcl
from cmf_mj.control.law import FRAME, SIGNALS, Law, load_law

HARDWARE_VELOCITY = {
    1: (
        "4.12",
        (0.002907, 1.357, 632.6, 1.597e5, 2.862e7, 3.596e9, 2.482e11),
        (1.0, 199.5, 1.232e5, 1.19e7, 1.014e9, 5.103e10, 8.28e11),
    ),
    2: (
        "4.15",
        (0.004401, 3.003, 1277.0, 3.536e5, 5.963e7, 6.912e9, 4.759e11),
        (1.0, 441.8, 1.611e5, 3.415e7, 2.303e9, 1.075e11, 1.621e12),
    ),
    3: (
        "4.18",
        (0.007454, 4.01, 2642.0, 7.91e5, 2.038e8, 3.111e10, 3.228e12, 1.862e14),
        (1.0, 354.9, 2.753e5, 5.008e7, 1.381e10, 7.422e11, 4.226e13, 6.516e14),
    ),
}
"""Linear models 1 to 3: equation number, numerator, denominator; leg velocity in in/s per %."""

DCL_INPUTS = ("reference", "position", "velocity", "acceleration", "cap_pressure", "rod_pressure")
"""Inputs of `dcl_state_space` [m, m, m/s, m/s^2, Pa, Pa]."""


def hardware_velocity(number: int) -> control.TransferFunction:
    """Leg velocity per command, in/s per %, of the report's linear model 1, 2 or 3, as printed.

    Raises:
        ValueError: there is no such model.
    """
    if number not in HARDWARE_VELOCITY:
        raise ValueError(f"number: {number} is not one of {', '.join(map(str, HARDWARE_VELOCITY))}")
    equation, numerator, denominator = HARDWARE_VELOCITY[number]
    return control.tf(
        numerator,
        denominator,
        inputs="command",
        outputs="velocity",
        name="Eq_" + equation.replace(".", "_"),
    )


def dcl_state_space(law: str | Law) -> control.StateSpace:
    """One leg of the DCL without its clamps: discrete at 2048 Hz, output a command fraction.

    States: compensator, error integral, derivative filters of error and reference, accelerometer
    filter. Inputs: `DCL_INPUTS`.

    Raises:
        ValueError: the law is refused.
    """
    dcl = make_dcl(load_law(law), 1)
    pole = dcl.error.derivative_pole
    # The compensator's signals as S_x (states) + S_u (inputs).
    of_states = np.zeros((len(SIGNALS), 5))
    of_inputs = np.zeros((len(SIGNALS), len(DCL_INPUTS)))
    row = {name: i for i, name in enumerate(SIGNALS)}
    column = {name: i for i, name in enumerate(DCL_INPUTS)}
    for name in ("reference", "position", "velocity", "cap_pressure", "rod_pressure"):
        of_inputs[row[name], column[name]] = 1.0
    of_inputs[row["position_error_rate"], [column["reference"], column["position"]]] = pole, -pole
    of_states[row["position_error_rate"], 2] = -pole
    of_inputs[row["velocity_error"], [column["reference"], column["velocity"]]] = pole, -1.0
    of_states[row["velocity_error"], 3] = -pole
    of_states[row["error_integral"], 1] = 1.0
    of_states[row["acceleration"], 4] = 1.0
    area = dcl.feedback.force_area
    of_inputs[row["force"], [column["cap_pressure"], column["rod_pressure"]]] = area, -area

    gains = dcl.compensator
    a = np.diag([gains.state_gain[0], 1.0, 1.0, 1.0, dcl.feedback.accelerometer_pole])
    b = np.zeros((5, len(DCL_INPUTS)))
    a[0] += gains.input_gain[0] @ of_states
    b[0] = gains.input_gain[0] @ of_inputs
    b[1, [column["reference"], column["position"]]] = FRAME, -FRAME
    a[2, 2] -= FRAME * pole
    b[2, [column["reference"], column["position"]]] = FRAME * pole, -FRAME * pole
    a[3, 3] -= FRAME * pole
    b[3, column["reference"]] = FRAME * pole
    b[4, column["acceleration"]] = dcl.feedback.accelerometer_gain
    c = gains.direct_gain @ of_states
    c[0, 0] += gains.output_gain[0]
    d = gains.direct_gain @ of_inputs
    return control.ss(a, b, c, d, FRAME, inputs=list(DCL_INPUTS), outputs=["command"], name="DCL")


def _with_position(velocity: control.TransferFunction) -> tuple[NDArray[np.float64], ...]:
    """Zero-order hold of velocity (in/s per %) and its integral, SI: A, B, C, D at 2048 Hz."""
    system = control.ss(velocity)
    balanced, scaling = linalg.matrix_balance(np.asarray(system.A), permute=False)
    b = np.linalg.solve(scaling, system.B)
    c = np.asarray(system.C) @ scaling
    scale = units.INCH / units.PERCENT
    order = balanced.shape[0]
    a = np.block([[balanced, np.zeros((order, 1))], [c * scale, np.zeros((1, 1))]])
    b = np.vstack([b, np.asarray(system.D) * scale])
    held = linalg.expm(np.block([[a, b], [np.zeros((1, order + 2))]]) * FRAME)
    position = np.zeros((1, order + 1))
    position[0, -1] = 1.0
    c = np.vstack([position, np.hstack([c * scale, np.zeros((1, 1))])])
    d = np.vstack([np.zeros((1, 1)), np.asarray(system.D) * scale])
    return held[:-1, :-1], held[:-1, -1:], c, d


def closed_loop(
    law: str | Law, velocity: control.TransferFunction, *, command_delay: int = 1
) -> control.StateSpace:
    """Leg position per leg reference with a law around a linear plant (Figure 4-5).

    Pressures and acceleration are zero, as in the report; the clamps do not act.

    Args:
        law: name, TOML file or loaded law.
        velocity: leg velocity per command [in/s per %].
        command_delay: frames between the DCL's output and the plant, at least 1.

    Returns:
        Discrete at 2048 Hz, reference to position, both in the same unit.

    Raises:
        ValueError: the law is refused, or the delay is less than a frame.
    """
    if command_delay < 1:
        raise ValueError(f"command_delay: {command_delay} frames must be at least 1")
    a, b, c, d = _with_position(velocity)
    plant = control.ss(
        a, b, c, d, FRAME, inputs=["delayed"], outputs=["position", "velocity"], name="plant"
    )
    shift = np.eye(command_delay, k=-1)
    delay = control.ss(
        shift,
        np.eye(command_delay, 1),
        np.eye(1, command_delay, k=command_delay - 1),
        [[0.0]],
        FRAME,
        inputs=["command"],
        outputs=["delayed"],
        name="delay",
    )
    return control.interconnect(
        [dcl_state_space(law), delay, plant],
        inputs=["reference"],
        outputs=["position"],
        name=f"closed_loop_{load_law(law).name}",
        ignore_inputs=["DCL.acceleration", "DCL.cap_pressure", "DCL.rod_pressure"],
    )
