"""Smaller systems: one leg, one degree of freedom, and without states that do nothing.

A linearised machine has states that some input never reaches or some output never shows: the valves
of other legs, the supply while the valves are closed.
"""

from collections.abc import Sequence

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.linear.law import FEEDBACK, labels, spread
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.machine.dof import dof_index
from cmf_mj.machine.geometry import DOFS
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.plant.plant import Plant

Matrix = NDArray[np.float64]


def reduced(
    system: control.StateSpace,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
) -> control.StateSpace:
    """A system between some of its signals, by name, without the states that cannot matter there.

    A state is dropped where no chain of non-zero entries leads to it from an input or from it to an
    output. The others are kept as they are, with their names.
    """
    columns = _chosen("inputs", inputs, system.input_labels)
    rows = _chosen("outputs", outputs, system.output_labels)
    a, b, c, d = (np.asarray(m) for m in (system.A, system.B, system.C, system.D))
    b, c, d = b[:, columns], c[rows], d[np.ix_(rows, columns)]
    links = a != 0.0
    kept = np.flatnonzero(
        spread(links, (b != 0.0).any(axis=1)) & spread(links.T, (c != 0.0).any(axis=0))
    )
    names = {
        "inputs": [system.input_labels[i] for i in columns],
        "outputs": [system.output_labels[i] for i in rows],
        "states": [system.state_labels[i] for i in kept],
    }
    matrices = a[np.ix_(kept, kept)], b[kept], c[:, kept], d
    return control.ss(*matrices, system.dt, name=system.name, **names)


def _chosen(field: str, names: Sequence[str] | None, there: list[str]) -> list[int]:
    if names is None:
        return list(range(len(there)))
    if len(names) == 0:
        raise InputError(f"{field}: none is given; allowed: some of {', '.join(there)}")
    return [there.index(check_name(field, name, there)) for name in names]


def leg_model(system: control.StateSpace, leg: int) -> control.StateSpace:
    """One leg, from 1 on, of a linearised plant, the commands of all others constant.

    The others' oil still gives way: a leg of the hexapod keeps the modes of the whole machine.
    Input `command`, outputs `FEEDBACK` with bare names; `reduced(..., outputs=[one])` of it is a
    single output.
    """
    legs = int(system.ninputs)
    if leg not in range(1, legs + 1):
        raise InputError(f"leg: {leg} is not one of 1 to {legs}")
    end = f"_{leg}" if legs > 1 else ""
    one = reduced(system, [f"command{end}"], [f"{name}{end}" for name in FEEDBACK])
    return control.ss(
        one, inputs=["command"], outputs=list(FEEDBACK), name=f"{system.name}_leg_{leg}"
    )


def jacobian_of(plant: Plant, pose: ArrayLike | None = None) -> Matrix:
    """d(legs)/d(pose), (6, 6), of a plant with the legs of the facility."""
    if plant.legs != len(DOFS):
        raise InputError(
            f"plant: has {plant.legs} legs; degrees of freedom need the facility's {len(DOFS)}"
        )
    return pose_jacobian(np.zeros(6) if pose is None else pose, plant.machine)


def dof_model(
    system: control.StateSpace, plant: Plant, pose: ArrayLike | None, dof: str
) -> control.StateSpace:
    """One degree of freedom of a linearised plant, moved by all legs and read from all legs.

    With J = d(legs)/d(pose) the commands are c = J_i w and the pose J^-1 l. A leg of full speed k
    then makes a pose of speed k w while the oil does not give way. The motion the others make along
    is left free. `system` is of `linearize` for the plant in the pose (6,) [m, rad].

    The input `<dof>_command` is a fraction of full command per leg and unit of J [1 for m, 1/m for
    rad]; outputs are `<dof>` [m or rad], `<dof>_rate` and `<dof>_acceleration`.
    """
    index = dof_index(dof)
    jacobian = jacobian_of(plant, pose)
    inverse = np.linalg.inv(jacobian)[index]
    rows = np.zeros((3, int(system.noutputs)))
    for i, name in enumerate(FEEDBACK[:3]):
        places = [system.output_labels.index(n) for n in labels((name,), plant.legs)]
        rows[i, places] = inverse
    places = [system.input_labels.index(n) for n in labels(("command",), plant.legs)]
    columns = np.zeros((int(system.ninputs), 1))
    columns[places, 0] = jacobian[:, index]
    b, c, d = (np.asarray(m) for m in (system.B, system.C, system.D))
    matrices = system.A, b @ columns, rows @ c, rows @ d @ columns
    names = {"inputs": [f"{dof}_command"], "states": system.state_labels}
    names["outputs"] = [dof, f"{dof}_rate", f"{dof}_acceleration"]
    return reduced(control.ss(*matrices, system.dt, name=f"{system.name}_{dof}", **names))
