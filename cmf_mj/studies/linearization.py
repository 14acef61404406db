"""A plant linearised in a configuration: modes, responses, loops of a law."""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.linear.operating_point import OperatingPoint, operating_point
from cmf_mj.analysis.linear.poles import Mode, modes
from cmf_mj.analysis.linear.reduction import dof_model, leg_model, pose_loop, reduced
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import check_name
from cmf_mj.facility.binding import bound
from cmf_mj.machine.dof import dof_index
from cmf_mj.plant.plant import Plant

FREQUENCIES = np.geomspace(0.1, 20.0, 400)
"""Lines of the responses [Hz]."""


class LinearizationStudy(NamedTuple):
    """A plant linearised in a configuration, with loops of one law."""

    plant: Plant
    pose: NDArray[np.float64]  #: [m, rad], (6,).
    law: str
    point: OperatingPoint
    system: control.StateSpace
    modes: tuple[Mode, ...]
    responses: dict[str, FrequencyResponse]  #: Position per command, by degree of freedom or leg.
    loops: dict[str, FrequencyResponse]  #: Demand to position under the law.
    stable: bool  #: Whether all poles of the loops lie within the unit circle.


def linearization_study(
    plant: Plant, law: str, pose: NDArray[np.float64], signals: Sequence[str]
) -> LinearizationStudy:
    """Linearise a plant and close a law around it.

    `pose` is (6,) in m and rad; `signals` are degrees of freedom or legs.
    """
    load_law(law)
    point = operating_point(plant, pose)
    system = linearize(plant, at=point)
    legs, systems = [f"leg_{leg + 1}" for leg in range(plant.legs)], {}
    for name in signals:
        if name.startswith("leg_"):
            leg = legs.index(check_name("dof", name, legs)) + 1
            systems[name] = reduced(leg_model(system, leg), outputs=["leg_position"])
        else:
            systems[name] = reduced(dof_model(system, plant, pose, name), outputs=[name])
    loops = {name: loop_between(plant, system, law, pose, name) for name in signals}
    return LinearizationStudy(
        *(plant, pose, law, point, system, modes(system, plant, pose)),
        {name: loop_response(model, FREQUENCIES) for name, model in systems.items()},
        {name: loop_response(loop, FREQUENCIES) for name, loop in loops.items()},
        all(bool(np.abs(loop.poles()).max() < 1.0) for loop in loops.values()),
    )


def loop_between(
    plant: Plant,
    system: control.StateSpace,
    law: str | Law,
    pose: ArrayLike | None,
    signal: str,
    *,
    command_delay: int = 1,
) -> control.StateSpace:
    """The loop of a law around a linearised plant, from a demand to its position.

    `system` is the plant linearised in `pose`; `signal` is a degree of freedom, or a leg, `leg_1`
    and so on. The loop has one input and one output, at 2048 Hz; all other demands are zero.
    """
    loop = closed_loop(bound(load_law(law), plant), system, command_delay=command_delay)
    legs = [f"leg_{leg + 1}" for leg in range(plant.legs)]
    if not signal.startswith("leg_"):
        index = dof_index(signal)
        loop = pose_loop(loop, plant, pose)
    else:
        index = legs.index(check_name("dof", signal, legs))
    return loop[index, index]
