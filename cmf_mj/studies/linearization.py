"""A plant linearised in a configuration: responses, and loops of a law."""

from collections.abc import Sequence
from typing import NamedTuple

import control
import numpy as np

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.poles import Mode, dof_model, leg_model, reduced
from cmf_mj.analysis.measures import are_stable

FREQUENCIES = np.geomspace(0.1, 20.0, 400)
"""Lines of the responses [Hz]."""


class LinearizationStudy(NamedTuple):
    """A plant linearised in a configuration, with loops of one law."""

    linear: Linear
    law: str
    modes: tuple[Mode, ...]
    responses: dict[str, FrequencyResponse]  #: Position per command, by degree of freedom or leg.
    loops: dict[str, FrequencyResponse]  #: Demand to position under the law.
    stable: bool  #: The verdict on all of these loops.


def linearization_study(linear: Linear, law: str, signals: Sequence[str]) -> LinearizationStudy:
    """Close a law around a linearised plant; `signals` are degrees of freedom or legs."""
    loops = {name: linear.loop(law, name) for name in signals}
    return LinearizationStudy(
        linear,
        law,
        linear.modes(),
        {name: loop_response(_moved(linear, name), FREQUENCIES) for name in signals},
        {name: loop_response(loop, FREQUENCIES) for name, loop in loops.items()},
        all(are_stable(loop.poles()) for loop in loops.values()),
    )


def _moved(linear: Linear, name: str) -> control.StateSpace:
    """A degree of freedom or a leg, from its command to its position."""
    if name.startswith("leg_"):
        return reduced(leg_model(linear.system, int(name[4:])), outputs=["leg_position"])
    return reduced(dof_model(linear.system, linear.plant, linear.pose, name), outputs=[name])
