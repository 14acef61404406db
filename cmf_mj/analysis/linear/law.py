"""The digital control law as a linear system: any law, any number of legs, no clamps.

The blocks of `cmf_mj.control` in their linear range: no demand or command clamped, the error
integral engaged and away from its bounds. The matrices are what the compiled law answers to states
and inputs of one unit each, so that they are those of what runs.
"""

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.control.dcl import Dcl, DclState, make_dcl, step
from cmf_mj.control.feedback import LegFeedback
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError

FEEDBACK = ("leg_position", "leg_velocity", "leg_acceleration", "cap_pressure", "rod_pressure")
"""What a leg's sensors give the DCL [m, m/s, m/s^2, Pa, Pa]."""

DCL_INPUTS = ("reference", *FEEDBACK)
"""Inputs of `dcl_state_space` for each leg; the reference in m."""

Matrix = NDArray[np.float64]

_STATES = tuple(name for name in DclState.zeros(1).arrays() if name != "offset")

_SIZE = 2.0**-30
"""Size of states and inputs that the law is asked with: no clamp acts, and no digit is lost."""


def labels(names: tuple[str, ...], legs: int) -> list[str]:
    """Signal names of all legs, bare for one leg, else `name_1`, `name_2`, name by name."""
    if legs == 1:
        return list(names)
    return [f"{name}_{leg + 1}" for name in names for leg in range(legs)]


def _answers(
    dcl: Dcl, legs: int, states: Matrix, inputs: Matrix
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Output and next state of one frame, per unit; states (m, n) and inputs (6, n)."""
    still = {"offset": np.zeros(legs)}
    state = DclState.of(still | dict(zip(_STATES, _SIZE * states, strict=True)))
    reference, *feedback = _SIZE * inputs
    step(dcl, state, reference, LegFeedback(*feedback))
    after = state.arrays()
    following = np.concatenate([after[name] for name in _STATES])
    return dcl.workspace.output / _SIZE, following / _SIZE


def dcl_state_space(law: str | Law, legs: int = 1) -> control.StateSpace:
    """The DCL without its clamps: discrete at 2048 Hz.

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
    asked = 1 if loaded.coordinates == "legs" else legs
    dcl = make_dcl(loaded, asked)
    count = len(_STATES) * asked
    rows = []
    for unit in np.eye(count + len(DCL_INPUTS) * asked):
        states, inputs = unit[:count].reshape(-1, asked), unit[count:].reshape(-1, asked)
        rows.append(np.concatenate(_answers(dcl, asked, states, inputs)))
    answers = np.array(rows).T
    c, d, a, b = (
        np.asarray(np.kron(part, np.eye(legs // asked)), dtype=np.float64)
        for half in (answers[:asked], answers[asked:])
        for part in (half[:, :count], half[:, count:])
    )
    kept = _acting(a, c, legs)
    names = {"inputs": labels(DCL_INPUTS, legs), "outputs": labels(("command",), legs)}
    names["states"] = [labels(_STATES, legs)[i].replace(".", "_") for i in kept]
    matrices = a[np.ix_(kept, kept)], b[kept], c[:, kept], d
    return control.ss(*matrices, loaded.frame, name="DCL", **names)


def _acting(a: Matrix, c: Matrix, legs: int) -> NDArray[np.int64]:
    """States that reach the output, of all legs where they do of one; the compensator always."""
    kinds = a.shape[0] // legs
    links = (a != 0.0).reshape(kinds, legs, kinds, legs).any(axis=(1, 3))
    seen = (c != 0.0).reshape(-1, kinds, legs).any(axis=(0, 2))
    seen[0] = True
    return np.flatnonzero(np.repeat(spread(links.T, seen), legs))


def spread(links: NDArray[np.bool_], start: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """All states that a chain of links, row from column, reaches."""
    reached = start
    while True:
        after = reached | (links[:, reached].any(axis=1))
        if (after == reached).all():
            return reached
        reached = after
