"""A law around a linear plant (Figure 4-5): discrete at 2048 Hz, one frame of command delay.

    command[k] = DCL(reference[k], feedback[k]),   the plant sees it from frame k + delay on

The plant is a transfer function of one leg, or a state space of one leg or several: inputs
`command` [fraction] and outputs `FEEDBACK`, or `command_1` and on, `leg_position_1` and on. Legs
may be coupled.
"""

import re
from typing import Literal

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.law import FEEDBACK, dcl_state_space, labels
from cmf_mj.analysis.linear.plants import leg_plant
from cmf_mj.analysis.linear.transfer import UnitTransferFunction
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.rates import FRAME

OUTPUTS = (*FEEDBACK, "command")
"""Outputs a closed loop can have."""

Pressures = Literal["modelled", "zero"]
"""Whether the law sees the plant's pressures; a plant without them has zero pressures."""

STEP_DURATION = 10.0
"""Length of the steps measured [s]."""

Matrix = NDArray[np.float64]


def closed_loop(
    law: str | Law,
    plant: UnitTransferFunction | control.StateSpace,
    *,
    command_delay: int = 1,
    pressures: Pressures = "modelled",
    outputs: tuple[str, ...] = ("leg_position",),
) -> control.StateSpace:
    """Close the loop of a law around a linear plant; the clamps do not act.

    Args:
        law: name, TOML file or loaded law.
        plant: a transfer function as for `leg_plant`, or a state space, continuous or discrete at
            2048 Hz, in SI units. A single input may have any name. Of its outputs, position must be
            there, velocity and acceleration where the law reads them.
        command_delay: frames between the DCL's output and the plant, at least 1.
        pressures: `zero` hides the plant's pressures from the law, as in the report.
        outputs: some of `OUTPUTS`.

    Returns:
        Discrete at 2048 Hz, SI: from `reference` [m] to the outputs; with several legs from
        `reference_1` and on to `leg_position_1` and on, leg by leg within an output.

    Raises:
        InputError: the law is refused, the delay is less than a frame, or the plant or an output
            has other names, another rate, or lacks what the law reads.
    """
    if command_delay < 1:
        raise InputError(f"command_delay: {command_delay} frames must be at least 1")
    for name in outputs:
        if name not in OUTPUTS:
            raise InputError(f"outputs: {name!r} is not one of {', '.join(OUTPUTS)}")
    if pressures not in ("modelled", "zero"):
        raise InputError(f"pressures: {pressures!r} is not one of modelled, zero")
    loaded = load_law(law)
    held = _at_frames(plant)
    legs = _legs(held)
    law_system = dcl_state_space(loaded, legs)
    c, d = _feedback_rows(held, legs, law_system, outputs)
    a, b = np.asarray(held.A), np.asarray(held.B)[:, _commands(held, legs)]
    a, b, c, d = _delayed((a, b, c, d), command_delay)
    # With reference r, feedback y and command u: y = C x, since the delay takes the direct term.
    ak, bk, ck, dk = (
        np.asarray(m) for m in (law_system.A, law_system.B, law_system.C, law_system.D)
    )
    br, by, dr, dy = bk[:, :legs], bk[:, legs:], dk[:, :legs], dk[:, legs:]
    seen = c.copy()
    if pressures == "zero":
        seen[3 * legs :] = 0.0
    law_order = ak.shape[0]
    loop_a = np.block([[a + b @ dy @ seen, b @ ck], [by @ seen, ak]])
    loop_b = np.vstack([b @ dr, br])
    rows = {
        name: (np.hstack([c[i * legs : (i + 1) * legs], np.zeros((legs, law_order))]), 0.0 * dr)
        for i, name in enumerate(FEEDBACK)
    }
    rows["command"] = (np.hstack([dy @ seen, ck]), dr)
    return control.ss(
        loop_a,
        loop_b,
        np.vstack([rows[name][0] for name in outputs]),
        np.vstack([rows[name][1] for name in outputs]),
        FRAME,
        inputs=labels(("reference",), legs),
        outputs=labels(outputs, legs),
        name=f"closed_loop_{re.sub(r'[^A-Za-z0-9_]', '_', loaded.name)}",
    )


def _at_frames(plant: UnitTransferFunction | control.StateSpace) -> control.StateSpace:
    """The plant as a state space at 2048 Hz, its input held over a frame."""
    if isinstance(plant, UnitTransferFunction):
        return leg_plant(plant)
    if not isinstance(plant, control.StateSpace):
        raise InputError(
            f"plant: {type(plant).__name__} is refused: a StateSpace is needed, or a transfer "
            "function with units, UnitTransferFunction"
        )
    if plant.isctime(strict=True):
        return control.sample_system(plant, FRAME, method="zoh", copy_names=True)
    if plant.dt is True or plant.dt is None or not np.isclose(plant.dt, FRAME, rtol=1e-9):
        raise InputError(f"plant: its sampling time {plant.dt} must be {FRAME} s or continuous")
    return plant


def _legs(plant: control.StateSpace) -> int:
    legs = int(plant.ninputs)
    wanted = set(labels(("command",), legs))
    if legs > 1 and set(plant.input_labels) != wanted:
        raise InputError(
            f"plant: its inputs {', '.join(plant.input_labels)} must be command_1 to command_{legs}"
        )
    return legs


def _commands(plant: control.StateSpace, legs: int) -> list[int]:
    if legs == 1:
        return [0]
    return [plant.input_labels.index(name) for name in labels(("command",), legs)]


def _feedback_rows(
    plant: control.StateSpace,
    legs: int,
    law_system: control.StateSpace,
    outputs: tuple[str, ...],
) -> tuple[Matrix, Matrix]:
    """C and D of all `FEEDBACK`, zero where the plant lacks an output that nothing reads."""
    c = np.zeros((len(FEEDBACK) * legs, plant.nstates))
    d = np.zeros((len(FEEDBACK) * legs, legs))
    columns = _commands(plant, legs)
    read = np.any(np.vstack([law_system.B, law_system.D])[:, legs:] != 0.0, axis=0)
    present = {label: i for i, label in enumerate(plant.output_labels)}
    for i, label in enumerate(labels(FEEDBACK, legs)):
        if label in present:
            c[i] = plant.C[present[label]]
            d[i] = plant.D[present[label]][columns]
            continue
        name = FEEDBACK[i // legs]
        if name in outputs or (read[i] and i < 3 * legs):
            raise InputError(
                f"plant: has no output {label}, which is needed; it has {', '.join(present)}"
            )
    return c, d


def _delayed(matrices: tuple[Matrix, ...], frames: int) -> tuple[Matrix, ...]:
    """The plant behind a register of `frames` commands a leg."""
    a, b, c, d = matrices
    order, legs = b.shape
    shift = np.kron(np.eye(frames, k=-1), np.eye(legs))
    last = np.kron(np.eye(1, frames, k=frames - 1), np.eye(legs))
    first = np.kron(np.eye(frames, 1), np.eye(legs))
    return (
        np.block([[a, b @ last], [np.zeros((frames * legs, order)), shift]]),
        np.vstack([np.zeros((order, legs)), first]),
        np.hstack([c, d @ last]),
        np.zeros_like(d),
    )


def loop_response(
    loop: control.StateSpace, frequency: NDArray[np.float64], output: int = 0, input: int = 0
) -> FrequencyResponse:
    """The exact frequency response of a closed loop, as measured ones are given.

    Args:
        loop: of `closed_loop`, or any other linear system.
        frequency: [Hz], ascending, (K,).
        output: index of the output.
        input: index of the input.

    Returns:
        With coherence 1 and bound 0.
    """
    omega = 2.0 * np.pi * np.asarray(frequency, dtype=float)
    response = control.frequency_response(loop, omega).frdata[output, input]
    ones = np.ones(omega.size)
    return FrequencyResponse(
        response,
        omega,
        ones,
        0.0 * ones,
        inputs=[loop.input_labels[input]],
        outputs=[loop.output_labels[output]],
    )


def loop_step(
    loop: control.StateSpace, duration: float = STEP_DURATION, output: int = 0, input: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time [s] and response of a closed loop to a unit step at 2048 Hz, both (N,)."""
    time = np.arange(round(duration / FRAME)) * FRAME
    response = control.step_response(loop, time, input=input, output=output)
    return np.asarray(time, dtype=np.float64), np.asarray(response.outputs).reshape(-1)
