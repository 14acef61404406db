"""A law around a linear plant (Figure 4-5): discrete at 2048 Hz, one frame of command delay.

    command[k] = DCL(reference[k], feedback[k]),   the plant sees it from frame k + delay on

The plant is a transfer function of one leg, or a state space of one leg or several: inputs
`command` [fraction] and outputs `FEEDBACK`, or `command_1` and on, `leg_position_1` and on. Legs
may be coupled.

A plant of which only responses are known, measured or of a model, is closed line by line. With V
the n by n response of velocities to commands, P those of pressures, B the law's gain from each of
its inputs and H = e^(-s d T0) (1 - e^(-s T0)) / (s T0) delay and hold,

    position = H V / s (1 - H (B_x V / s + B_v V + B_a s e^(-s T0) V + B_p P))^-1 B_r reference

The same law on every axis is a number times 1, and the axes may be any; a law in hydraulic modes is
a matrix. The accelerometer is one frame late, as in the simulation.

The report's zero pressures are nearly right for a single leg and in heave, where the law's
pressure terms move the -90 deg bandwidth by 0.3 %. In surge and sway of the hexapod, whose legs
swing the largest mass, they slow it by about 2 %: models of the pressures belong into that loop.
"""

import re
from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.plants import FEEDBACK, UnitTransferFunction, leg_plant
from cmf_mj.control.dcl import DclState, make_dcl, step
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError, check_name

DCL_INPUTS = ("reference", *FEEDBACK)
"""Inputs of `dcl_state_space` for each leg; the reference in m."""

_PRESSURES = FEEDBACK.index("cap_pressure")  #: Where the pressures begin in `FEEDBACK`.

Matrix = NDArray[np.float64]

_STATES = tuple(name for name in DclState.zeros(1).arrays() if name != "offset")

_SIZE = 2.0**-30
"""Size of states and inputs that the law is asked with: no clamp acts, and no digit is lost."""


def labels(names: tuple[str, ...], legs: int) -> list[str]:
    """Signal names of all legs, bare for one leg, else `name_1`, `name_2`, name by name."""
    if legs == 1:
        return list(names)
    return [f"{name}_{leg + 1}" for name in names for leg in range(legs)]


@compiled
def _answer(dcl, state, feedback, states, inputs, units, answers):  # type: ignore[no-untyped-def]
    """Write output and next state of one frame from each of the units, (m, n + 6) to (m, 1 + n).

    `states` are the arrays of `state`, `inputs` the demand and those of `feedback`, part by part.
    """
    legs, count = inputs[0].shape[0], len(states)
    for row in range(units.shape[0]):
        for leg in range(legs):
            for part in range(count):
                states[part][leg] = units[row, part * legs + leg]
            for part in range(len(inputs)):
                inputs[part][leg] = units[row, (count + part) * legs + leg]
        step(dcl, state, inputs[0], feedback)
        for leg in range(legs):
            answers[row, leg] = dcl.workspace.output[leg]
            for part in range(count):
                answers[row, (1 + part) * legs + leg] = states[part][leg]


def dcl_state_space(law: str | Law, legs: int = 1) -> control.StateSpace:
    """The DCL without its clamps, in its linear range: discrete at 2048 Hz.

    No demand or command is clamped, the error integral is engaged and away from its bounds.

    The compiled law is asked with one state or input at a time, in leg coordinates for one leg,
    whose matrices all legs share. Of the states of each leg or mode those are kept that can act on
    the command. An adapting law is linear while its factor stands still: this is the law with the
    factor at 1. A law in hydraulic modes must be `bound_to` a cab.

    Inputs are `DCL_INPUTS`, the output `command` [fraction]; with several legs `reference_1` and so
    on.
    """
    if legs < 1:
        raise InputError(f"legs: {legs} must be at least 1")
    loaded = load_law(law)
    key = loaded.model_dump_json(), loaded.machine.model_dump_json(), legs
    if (found := _ASKED.get(key)) is None:
        found = _asked(loaded, legs)
        if len(_ASKED) >= _MOST:
            _ASKED.pop(next(iter(_ASKED)), None)
        _ASKED[key] = found
    *matrices, states = found
    names = {"inputs": labels(DCL_INPUTS, legs), "outputs": labels(("command",), legs)}
    matrices = [matrix.copy() for matrix in matrices]
    return control.ss(*matrices, loaded.frame, name="DCL", states=states, **names)


_MOST = 64  #: Laws whose answers are kept: many plants are asked about the same few.
_ASKED: dict[tuple[str, str, int], tuple[Any, ...]] = {}


def _asked(law: Law, legs: int) -> tuple[Any, ...]:
    """Matrices A, B, C and D of the DCL and the names of its states."""
    asked = 1 if law.coordinates == "legs" else legs
    dcl, state = make_dcl(law, asked), DclState.zeros(asked)
    arrays = state.arrays()
    states = tuple(arrays[name] for name in _STATES)
    inputs = tuple(np.zeros(asked) for _ in DCL_INPUTS)
    units = _SIZE * np.eye((len(states) + len(inputs)) * asked)
    count = len(states) * asked
    answers = np.empty((len(units), asked + count))
    _answer(dcl, state, LegFeedback(*inputs[1:]), states, inputs, units, answers)
    answers = answers.T / _SIZE
    c, d, a, b = (
        np.asarray(np.kron(part, np.eye(legs // asked)), dtype=np.float64)
        for half in (answers[:asked], answers[asked:])
        for part in (half[:, :count], half[:, count:])
    )
    # Of all legs those states that reach the output of one do; the compensator's always counts.
    kinds = a.shape[0] // legs
    links = (a != 0.0).reshape(kinds, legs, kinds, legs).any(axis=(1, 3))
    seen = (c != 0.0).reshape(-1, kinds, legs).any(axis=(0, 2))
    seen[0] = True
    kept = np.flatnonzero(np.repeat(reached(links.T, seen), legs))
    names = [labels(_STATES, legs)[i].replace(".", "_") for i in kept]
    return a[np.ix_(kept, kept)], b[kept], c[:, kept], d, names


def reached(links: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """All states that a chain of links, row from column, reaches."""
    while not ((after := start | links[:, start].any(axis=1)) == start).all():
        start = after
    return start


OUTPUTS = (*FEEDBACK, "command")  #: Outputs a closed loop can have.

STEP_DURATION = 10.0  #: Length of the steps measured [s].

Complex = NDArray[np.complex128]


def closed_loop(
    law: str | Law,
    plant: UnitTransferFunction | control.StateSpace,
    *,
    command_delay: int = 1,
    outputs: tuple[str, ...] = ("leg_position",),
) -> control.StateSpace:
    """Close the loop of a law around a linear plant; the clamps do not act.

    `plant` is a transfer function as for `leg_plant`, or a state space in SI units, continuous or
    discrete at the law's rate; a single input may have any name. Of its outputs, position must be
    there, velocity and acceleration where the law reads them. `command_delay` counts frames between
    the DCL's output and the plant, at least 1. `outputs` are some of `OUTPUTS`.

    The loop is discrete at the law's rate, SI: from `reference` [m] to the outputs; with several
    legs from `reference_1` and on to `leg_position_1` and on, leg by leg within an output. Raises
    `InputError` for a plant that has other names, another rate, or lacks what the law reads.
    """
    if command_delay < 1:
        raise InputError(f"command_delay: {command_delay} frames must be at least 1")
    for name in outputs:
        check_name("outputs", name, OUTPUTS)
    loaded = load_law(law)
    sampled = at_frames(plant, loaded.frame)
    legs, given = int(sampled.ninputs), sampled.input_labels
    expected = given if legs == 1 else labels(("command",), legs)  # a single one has any name
    if set(given) != set(expected):
        raise InputError(
            f"plant: its inputs {', '.join(given)} must be command_1 to command_{legs}"
        )
    columns = [given.index(name) for name in expected]
    law_system = dcl_state_space(loaded, legs)
    c, d = _feedback_rows(sampled, columns, law_system, outputs)
    a, b = np.asarray(sampled.A), np.asarray(sampled.B)[:, columns]
    a, b, c, d = _delayed((a, b, c, d), command_delay)
    # With reference r, feedback y and command u: y = C x, since the delay takes the direct term.
    ak, bk, ck, dk = (
        np.asarray(m) for m in (law_system.A, law_system.B, law_system.C, law_system.D)
    )
    br, by, dr, dy = bk[:, :legs], bk[:, legs:], dk[:, :legs], dk[:, legs:]
    law_order = ak.shape[0]
    loop_a = np.block([[a + b @ dy @ c, b @ ck], [by @ c, ak]])
    loop_b = np.vstack([b @ dr, br])
    rows = {
        name: (np.hstack([c[i * legs : (i + 1) * legs], np.zeros((legs, law_order))]), 0.0 * dr)
        for i, name in enumerate(FEEDBACK)
    }
    rows["command"] = (np.hstack([dy @ c, ck]), dr)
    loop_c, loop_d = (np.vstack([rows[name][i] for name in outputs]) for i in (0, 1))
    names = {"inputs": labels(("reference",), legs), "outputs": labels(outputs, legs)}
    name = f"closed_loop_{re.sub(r'[^A-Za-z0-9_]', '_', loaded.name)}"
    return control.ss(loop_a, loop_b, loop_c, loop_d, loaded.frame, name=name, **names)


def at_frames(plant: UnitTransferFunction | control.StateSpace, frame: float) -> control.StateSpace:
    """The plant as a state space of control frames [s], its input constant over each."""
    if isinstance(plant, UnitTransferFunction):
        return leg_plant(plant, frame=frame)
    if not isinstance(plant, control.StateSpace):
        raise InputError(
            f"plant: {type(plant).__name__} is refused: a StateSpace is needed, or a transfer "
            "function with units, UnitTransferFunction"
        )
    if plant.isctime(strict=True):
        return control.sample_system(plant, frame, method="zoh", copy_names=True)
    if plant.dt is True or plant.dt is None or not np.isclose(plant.dt, frame, rtol=1e-9):
        raise InputError(f"plant: its sampling time {plant.dt} must be {frame} s or continuous")
    return plant


def _feedback_rows(
    plant: control.StateSpace,
    columns: list[int],
    law_system: control.StateSpace,
    outputs: tuple[str, ...],
) -> tuple[Matrix, Matrix]:
    """C and D of all `FEEDBACK`, zero where the plant lacks an output that nothing reads."""
    legs = len(columns)
    c = np.zeros((len(FEEDBACK) * legs, plant.nstates))
    d = np.zeros((len(FEEDBACK) * legs, legs))
    read = np.any(np.vstack([law_system.B, law_system.D])[:, legs:] != 0.0, axis=0)
    present = {label: i for i, label in enumerate(plant.output_labels)}
    for i, label in enumerate(labels(FEEDBACK, legs)):
        if label in present:
            c[i] = plant.C[present[label]]
            d[i] = plant.D[present[label]][columns]
            continue
        name = FEEDBACK[i // legs]
        if name in outputs or (read[i] and i < _PRESSURES * legs):
            raise InputError(f"plant: has no output {label}; it has {', '.join(present)}")
    return c, d


def _delayed(matrices: tuple[Matrix, ...], frames: int) -> tuple[Matrix, ...]:
    """The plant behind a register of `frames` commands a leg."""
    a, b, c, d = matrices
    order, legs = b.shape
    shift = np.eye(frames * legs, k=-legs)
    first, last = np.eye(frames * legs, legs), np.eye(legs, frames * legs, k=(frames - 1) * legs)
    joined = np.block([[a, b @ last], [np.zeros((frames * legs, order)), shift]])
    entry = np.vstack([np.zeros((order, legs)), first])
    return joined, entry, np.hstack([c, d @ last]), np.zeros_like(d)


def loop_response(loop: control.StateSpace, frequency: NDArray[np.float64]) -> FrequencyResponse:
    """The exact response of a SISO loop or other linear system at `frequency` [Hz], (K,).

    It has the form of measured ones, with coherence 1 and bound 0.
    """
    omega = 2.0 * np.pi * np.asarray(frequency, dtype=float)
    response = control.frequency_response(loop, omega).frdata[0, 0]
    ones = np.ones(omega.size)
    names = {"inputs": loop.input_labels[:1], "outputs": loop.output_labels[:1]}
    return FrequencyResponse(response, omega, ones, 0.0 * ones, **names)


def loop_step(
    loop: control.StateSpace, duration: float = STEP_DURATION
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Time [s] and response of a discrete SISO loop to a unit step, both (N,)."""
    time = np.arange(round(duration / loop.dt)) * loop.dt
    response = control.step_response(loop, time)
    return np.asarray(time, dtype=np.float64), np.asarray(response.outputs).reshape(-1)


def closed_loop_response(
    law: str | Law,
    velocity: ArrayLike,
    frequency: ArrayLike,
    *,
    pressures: tuple[ArrayLike, ArrayLike] | None = None,
) -> Complex:
    """Response (K, n, n) from leg or axis references to positions with a law around a plant.

    `velocity` is the plant's response from commands at the valves to velocities, (K, n, n) or (K,)
    [m/s per full command], with neither computing delay nor hold, as `experiment` gives it;
    `pressures` those to cap and rod pressures [Pa per full command], default zero. `frequency`
    [Hz], (K,), lies above 0; the command is one frame late. A law in hydraulic modes is `bound_to`
    a cab, and the axes are the legs.
    """
    f = np.asarray(frequency, dtype=float)
    if not (f > 0.0).all():
        raise InputError("frequency: must be greater than 0 at every line")
    v = _square("velocity", velocity, f.size)
    s = 2j * np.pi * f[:, None, None]
    loaded = load_law(law)
    gain, frame = _law_gains(loaded, f, v.shape[1]), loaded.frame
    hold = (1.0 - np.exp(-s * frame)) / (s * frame) * np.exp(-s * frame)
    late = s * np.exp(-s * frame)
    back = (gain["leg_position"] / s + gain["leg_velocity"] + gain["leg_acceleration"] * late) @ v
    if pressures is not None:
        for name, values in zip(("cap_pressure", "rod_pressure"), pressures, strict=True):
            back = back + gain[name] @ _square(name, values, f.size)
    command = np.linalg.solve(np.eye(v.shape[1]) - hold * back, gain["reference"])
    return np.asarray(hold / s * v @ command)


def _law_gains(law: Law, frequency: Matrix, axes: int) -> dict[str, Complex]:
    """Responses of the DCL along axes from each of its inputs to the command, (K, n, n) each."""
    coupled = law.coordinates != "legs"
    system = dcl_state_space(law, axes if coupled else 1)
    rows = control.frequency_response(system, 2.0 * np.pi * frequency).frdata
    if coupled:
        by_leg = np.split(np.moveaxis(rows, -1, 0), len(DCL_INPUTS), axis=2)
        parts = [np.ascontiguousarray(part) for part in by_leg]
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
