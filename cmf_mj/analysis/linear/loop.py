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
a matrix. The accelerometer is one frame late, as in the simulation. The report's zero pressures
slow the -90 deg bandwidth by 0.3 % for a single leg and in heave, by 2 % in surge and sway.
"""

import re
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.plants import (
    FEEDBACK,
    MOTIONS,
    UnitTransferFunction,
    leg_plant,
    reachable_states,
)
from cmf_mj.control.dcl import DclState, make_dcl, step
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.compiled import compiled
from cmf_mj.core.errors import InputError, check_name

DCL_INPUTS = ("reference", *FEEDBACK)  #: Inputs of the DCL for each leg; the reference in m.

OUTPUTS = (*FEEDBACK, "command")  #: Outputs a closed loop can have.
STEP_DURATION = 10.0  #: Length of the steps measured [s].

Matrix = NDArray[np.float64]
Complex = NDArray[np.complex128]

_STEP_BLOCK = 64  #: Frames between the states that `loop_steps` goes through.
_DCL_STATES = tuple(name for name in DclState.zeros(1).arrays() if name != "offset")
"""States of the DCL that its linear system may have."""
_PROBE_SIZE = 2.0**-30  #: Of states and inputs that probe the law: no clamp acts, no digit is lost.
_MOST_LAWS = 64  #: Laws whose matrices stay in memory: many plants are closed with the same few.


def labels(names: tuple[str, ...], legs: int) -> list[str]:
    """Signal names of all legs, bare for one leg, else `name_1`, `name_2`, name by name."""
    if legs == 1:
        return list(names)
    return [f"{name}_{leg + 1}" for name in names for leg in range(legs)]


@compiled
def _probe(dcl, state, feedback, states, inputs, probes, answers):  # type: ignore[no-untyped-def]
    """Write command and next states after one frame from each probe, (m, s + i) to (m, 1 + s).

    A probe has the s states and then the i inputs, each of all legs. `states` are the arrays of
    `state`, `inputs` the demand and the arrays of `feedback`.
    """
    legs, count = inputs[0].shape[0], len(states)
    for row in range(probes.shape[0]):
        for leg in range(legs):
            for kind in range(count):
                states[kind][leg] = probes[row, kind * legs + leg]
            for kind in range(len(inputs)):
                inputs[kind][leg] = probes[row, (count + kind) * legs + leg]
        step(dcl, state, inputs[0], feedback)
        for leg in range(legs):
            answers[row, leg] = dcl.workspace.output[leg]
            for kind in range(count):
                answers[row, (1 + kind) * legs + leg] = states[kind][leg]


def dcl_state_space(law: str | Law, legs: int = 1) -> control.StateSpace:
    """The DCL without its clamps, in its linear range: discrete at 2048 Hz.

    No demand or command is clamped, the error integral is engaged and away from its bounds.

    The compiled law is probed with one state or input at a time, in leg coordinates for one leg,
    whose matrices all legs share. States that cannot act on the command are left out. Of an
    adapting law this is the law with the factor at 1. A law in hydraulic modes must be `bound_to` a
    cab. Inputs are `DCL_INPUTS`, the output `command` [fraction]; with several legs `reference_1`
    and so on.
    """
    if legs < 1:
        raise InputError(f"legs: {legs} must be at least 1")
    loaded = load_law(law)
    key = loaded.model_dump_json(), loaded.machine.model_dump_json(), legs
    if key not in _MATRICES_OF_LAWS:
        if len(_MATRICES_OF_LAWS) >= _MOST_LAWS:
            oldest = next(iter(_MATRICES_OF_LAWS))
            _MATRICES_OF_LAWS.pop(oldest, None)
        _MATRICES_OF_LAWS[key] = _probed_matrices(loaded, legs)
    dcl = _MATRICES_OF_LAWS[key]
    matrices = [matrix.copy() for matrix in (dcl.a, dcl.b, dcl.c, dcl.d)]
    names = {"inputs": labels(DCL_INPUTS, legs), "outputs": labels(("command",), legs)}
    return control.ss(*matrices, loaded.frame, name="DCL", states=dcl.states, **names)


class _DclMatrices(NamedTuple):
    """The DCL as a linear system."""

    a: Matrix
    b: Matrix
    c: Matrix
    d: Matrix
    states: list[str]  #: Their names.


_MATRICES_OF_LAWS: dict[tuple[str, str, int], _DclMatrices] = {}


def _probed_matrices(law: Law, legs: int) -> _DclMatrices:
    """Matrices of the DCL from its answers to unit states and inputs."""
    axes = 1 if law.coordinates == "legs" else legs
    dcl, state = make_dcl(law, axes), DclState.zeros(axes)
    arrays = state.arrays()
    states = tuple(arrays[name] for name in _DCL_STATES)
    inputs = tuple(np.zeros(axes) for _ in DCL_INPUTS)
    probes = _PROBE_SIZE * np.eye((len(states) + len(inputs)) * axes)
    order = len(states) * axes
    answers = np.empty((len(probes), axes + order))
    _probe(dcl, state, LegFeedback(*inputs[1:]), states, inputs, probes, answers)
    answers = answers.T / _PROBE_SIZE
    command, next_states = answers[:axes], answers[axes:]
    a, b, c, d = (
        np.asarray(np.kron(part, np.eye(legs // axes)), dtype=np.float64)
        for part in (
            *(next_states[:, :order], next_states[:, order:]),
            *(command[:, :order], command[:, order:]),
        )
    )
    # A state that acts on the command of one leg stays for all; the compensator's always stays.
    kinds = a.shape[0] // legs
    links = (a != 0.0).reshape(kinds, legs, kinds, legs).any(axis=(1, 3))
    read_by_command = (c != 0.0).reshape(-1, kinds, legs).any(axis=(0, 2))
    read_by_command[0] = True
    acting_kinds = reachable_states(links.T, read_by_command)
    acting = np.flatnonzero(np.repeat(acting_kinds, legs))
    names = [labels(_DCL_STATES, legs)[i].replace(".", "_") for i in acting]
    return _DclMatrices(a[np.ix_(acting, acting)], b[acting], c[:, acting], d, names)


def closed_loop(
    law: str | Law,
    plant: UnitTransferFunction | control.StateSpace,
    *,
    command_delay: int = 1,
    outputs: tuple[str, ...] = ("leg_position",),
) -> control.StateSpace:
    """Close the loop of a law around a linear plant; the clamps do not act.

    `plant` is a transfer function as for `leg_plant`, or a state space in SI units, continuous or
    discrete at the law's rate, with the outputs that the law reads; a single input may have any
    name. `command_delay` counts frames between the DCL's output and the plant, at least 1.

    The loop is discrete at the law's rate, SI: from `reference` [m] to `outputs`, some of
    `OUTPUTS`; with several legs from `reference_1` and on to `leg_position_1` and on, leg by leg
    within an output. Raises `InputError` for a plant of other names, another rate, or that lacks an
    output.
    """
    if command_delay < 1:
        raise InputError(f"command_delay: {command_delay} frames must be at least 1")
    for name in outputs:
        check_name("outputs", name, OUTPUTS)
    loaded = load_law(law)
    sampled = at_frames(plant, loaded.frame)
    legs, inputs = int(sampled.ninputs), sampled.input_labels
    commands = inputs if legs == 1 else labels(("command",), legs)  # a single one has any name
    if set(inputs) != set(commands):
        names = ", ".join(inputs)
        raise InputError(f"plant: its inputs {names} must be command_1 to command_{legs}")
    columns = [inputs.index(name) for name in commands]
    dcl = dcl_state_space(loaded, legs)
    c, d = _feedback_rows(sampled, columns, dcl, outputs)
    a, b = np.asarray(sampled.A), np.asarray(sampled.B)[:, columns]
    a, b, c, d = _delayed((a, b, c, d), command_delay)
    # With reference r, feedback y and command u: y = C x, since the delay takes the direct term.
    ak, bk, ck, dk = (np.asarray(matrix) for matrix in (dcl.A, dcl.B, dcl.C, dcl.D))
    br, by, dr, dy = bk[:, :legs], bk[:, legs:], dk[:, :legs], dk[:, legs:]
    law_order = ak.shape[0]
    loop_a = np.block([[a + b @ dy @ c, b @ ck], [by @ c, ak]])
    loop_b = np.vstack([b @ dr, br])
    feedback_rows = np.split(np.hstack([c, np.zeros((len(c), law_order))]), len(FEEDBACK))
    c_of = dict(zip(FEEDBACK, feedback_rows, strict=True)) | {"command": np.hstack([dy @ c, ck])}
    d_of = dict.fromkeys(FEEDBACK, 0.0 * dr) | {"command": dr}
    loop_c = np.vstack([c_of[name] for name in outputs])
    loop_d = np.vstack([d_of[name] for name in outputs])
    port_names = {"inputs": labels(("reference",), legs), "outputs": labels(outputs, legs)}
    name = f"closed_loop_{re.sub(r'[^A-Za-z0-9_]', '_', loaded.name)}"
    return control.ss(loop_a, loop_b, loop_c, loop_d, loaded.frame, name=name, **port_names)


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
    is_read = np.any(np.vstack([law_system.B, law_system.D])[:, legs:] != 0.0, axis=0)
    plant_outputs = plant.output_labels
    for i, label in enumerate(labels(FEEDBACK, legs)):
        if label in plant_outputs:
            row = plant_outputs.index(label)
            c[i], d[i] = plant.C[row], plant.D[row][columns]
            continue
        name = FEEDBACK[i // legs]
        if name in outputs or (is_read[i] and name in MOTIONS):
            raise InputError(f"plant: has no output {label}; it has {', '.join(plant_outputs)}")
    return c, d


def _delayed(matrices: tuple[Matrix, ...], frames: int) -> tuple[Matrix, ...]:
    """The plant behind a register of `frames` commands a leg."""
    a, b, c, d = matrices
    order, legs = b.shape
    shift = np.eye(frames * legs, k=-legs)
    newest = np.eye(frames * legs, legs)
    oldest = np.eye(legs, frames * legs, k=(frames - 1) * legs)
    delayed_a = np.block([[a, b @ oldest], [np.zeros((frames * legs, order)), shift]])
    delayed_b = np.vstack([np.zeros((order, legs)), newest])
    return delayed_a, delayed_b, np.hstack([c, d @ oldest]), np.zeros_like(d)


def loop_response(loop: control.StateSpace, frequency: NDArray[np.float64]) -> FrequencyResponse:
    """The exact response of a SISO system at `frequency` [Hz], (K,), with coherence 1, bound 0."""
    omega = 2.0 * np.pi * np.asarray(frequency, dtype=float)
    response = control.frequency_response(loop, omega).frdata[0, 0]
    ones = np.ones(omega.size)
    names = {"inputs": loop.input_labels[:1], "outputs": loop.output_labels[:1]}
    return FrequencyResponse(response, omega, ones, 0.0 * ones, **names)


def loop_step(loop: control.StateSpace, duration: float = STEP_DURATION) -> tuple[Matrix, Matrix]:
    """Time [s] and response of a discrete SISO loop to a unit step, both (N,)."""
    time = np.arange(round(duration / loop.dt)) * loop.dt
    response = control.step_response(loop, time)
    return np.asarray(time, dtype=np.float64), np.asarray(response.outputs).reshape(-1)


def loop_steps(loop: control.StateSpace) -> Matrix:
    """Responses of a discrete loop to a unit step of each input, (N, outputs, inputs).

    Blocks of outputs from states a block apart: [C; CA; ...] x_k, x_(k+1) = A^n x_k + b.
    """
    a, b, c = (np.asarray(matrix) for matrix in (loop.A, loop.B, loop.C))
    order, inputs = b.shape
    # The demands are further states, which stand still.
    extended = np.block([[a, b], [np.zeros((inputs, order)), np.eye(inputs)]])
    rows = [np.hstack([c, np.asarray(loop.D)])]
    for _ in range(_STEP_BLOCK - 1):
        rows.append(rows[-1] @ extended)
    block_outputs = np.vstack(rows)
    block_step = np.linalg.matrix_power(extended, _STEP_BLOCK)
    state = np.vstack([np.zeros((order, inputs)), np.eye(inputs)])
    blocks = []
    for _ in range(round(STEP_DURATION / loop.dt / _STEP_BLOCK)):
        blocks.append((block_outputs @ state).reshape(_STEP_BLOCK, c.shape[0], inputs))
        state = block_step @ state
    return np.concatenate(blocks)


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
    v = _as_matrices("velocity", velocity, f.size)
    s = 2j * np.pi * f[:, None, None]
    loaded = load_law(law)
    gain, frame = _law_gains(loaded, f, v.shape[1]), loaded.frame
    hold = (1.0 - np.exp(-s * frame)) / (s * frame) * np.exp(-s * frame)
    late = s * np.exp(-s * frame)
    by_velocity = gain["leg_position"] / s + gain["leg_velocity"] + gain["leg_acceleration"] * late
    feedback = by_velocity @ v
    if pressures is not None:
        for name, values in zip(("cap_pressure", "rod_pressure"), pressures, strict=True):
            feedback = feedback + gain[name] @ _as_matrices(name, values, f.size)
    command = np.linalg.solve(np.eye(v.shape[1]) - hold * feedback, gain["reference"])
    return np.asarray(hold / s * v @ command)


def _law_gains(law: Law, frequency: Matrix, axes: int) -> dict[str, Complex]:
    """Responses of the DCL along axes from each of its inputs to the command, (K, n, n) each."""
    coupled = law.coordinates != "legs"
    system = dcl_state_space(law, axes if coupled else 1)
    rows = control.frequency_response(system, 2.0 * np.pi * frequency).frdata
    if coupled:
        by_input = np.split(np.moveaxis(rows, -1, 0), len(DCL_INPUTS), axis=2)
        parts = [np.ascontiguousarray(part) for part in by_input]
    else:
        parts = [row[:, None, None] * np.eye(axes) for row in rows[0]]
    return dict(zip(DCL_INPUTS, parts, strict=True))


def _as_matrices(name: str, values: ArrayLike, lines: int) -> Complex:
    """A response (K,) or (K, n, n) at so many lines as matrices (K, n, n)."""
    response = np.asarray(values, dtype=complex)
    response = response[:, None, None] if response.ndim == 1 else response
    if response.ndim != 3 or response.shape[0] != lines or response.shape[1] != response.shape[2]:
        allowed = f"({lines}, n, n) or ({lines},)"
        raise InputError(f"{name}: shape is {np.shape(values)}; allowed: {allowed}")
    return response
