"""A plant linearised in a configuration: modes, responses, minimal models, loops of a law."""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.operating_point import OperatingPoint, operating_point
from cmf_mj.analysis.linear.poles import Mode, modes
from cmf_mj.analysis.linear.reduction import dof_model, leg_model, minimal, reduced
from cmf_mj.control.law import load_law
from cmf_mj.core.errors import InputError
from cmf_mj.plant.plant import Plant
from cmf_mj.studies.linear_agreement import Comparison, compare_with_simulation, loop_between

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
    models: dict[str, control.StateSpace]  #: The same as minimal systems.
    loops: dict[str, FrequencyResponse]  #: Demand to position under the law.
    comparisons: dict[str, Comparison]
    """The loops compared with the simulation, where that was asked for."""


def signal_model(
    system: control.StateSpace, plant: Plant, pose: NDArray[np.float64], signal: str
) -> control.StateSpace:
    """Position per command of a degree of freedom, or of a leg, `leg_1` and so on; SISO."""
    if not signal.startswith("leg_"):
        return reduced(dof_model(system, plant, pose, signal), outputs=[signal])
    if not signal[4:].isdecimal():
        raise InputError(f"dof: {signal!r} is not one of leg_1 to leg_{plant.legs}")
    return reduced(leg_model(system, int(signal[4:])), outputs=["leg_position"])


def linearization_study(
    plant: Plant,
    law: str,
    pose: NDArray[np.float64],
    signals: Sequence[str],
    *,
    measure: bool = False,
) -> LinearizationStudy:
    """Linearise a plant and close a law around it.

    `pose` is (6,) in m and rad; `signals` are degrees of freedom or legs; `measure` runs the
    simulation of each loop too.
    """
    load_law(law)
    point = operating_point(plant, pose)
    system = linearize(plant, at=point)
    systems = {name: signal_model(system, plant, pose, name) for name in signals}
    loops = {name: loop_between(plant, system, law, pose, name) for name in signals}
    return LinearizationStudy(
        plant,
        pose,
        law,
        point,
        system,
        modes(system, plant, pose),
        {name: loop_response(model, FREQUENCIES) for name, model in systems.items()},
        {name: minimal(model) for name, model in systems.items()},
        {name: loop_response(loop, FREQUENCIES) for name, loop in loops.items()},
        {name: compare_with_simulation(plant, law, pose, name) for name in signals}
        if measure
        else {},
    )
