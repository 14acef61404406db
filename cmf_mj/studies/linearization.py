"""A plant linearised in a configuration: responses, and loops of a law."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.frequency_response import FrequencyResponse
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.poles import Mode, reduced
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
    plants = {name: linear.model(name) for name in signals}
    return LinearizationStudy(
        linear,
        law,
        linear.modes(),
        {
            name: loop_response(reduced(plant, outputs=plant.output_labels[:1]), FREQUENCIES)
            for name, plant in plants.items()
        },
        {name: loop_response(loop, FREQUENCIES) for name, loop in loops.items()},
        all(are_stable(loop.poles()) for loop in loops.values()),
    )
