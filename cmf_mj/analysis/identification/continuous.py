"""Identified models in continuous time, closed with the law and compared with the measured loop.

Series that were decimated are band-limited: the response of a discrete model on the unit circle is
the continuous one there, G(j w) = G_d(e^(j w T)) within the excited band, and `to_continuous` fits
the rational function of s that has this response.

A model of leg velocity per command is closed as in Figure 4-5, position by integration, pressures
zero, and compared with the measured loop in the terms of Table 4-1.
"""

from typing import NamedTuple

import control
import numpy as np

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.identification.model import PolynomialModel
from cmf_mj.analysis.identification.response_fit import ResponseFit, fit_response
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.linear.plants import UnitTransferFunction
from cmf_mj.analysis.measures import Measures, joined, measure_loop
from cmf_mj.analysis.step_response import StepMetrics
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError

BAND = (0.1, 10.0)
"""Band in which a band-limited model is believed [Hz]: the report's of interest (section 4.2)."""

_LINES = 200


def to_continuous(model: PolynomialModel) -> ResponseFit:
    """Continuous transfer function with the response of a discrete model over `BAND`.

    The model, of one input and one output, was identified from band-limited series. It keeps its
    number of poles, with one zero less. The fit is relative over 200 lines evenly spaced in log
    frequency; look at its `misfit`.
    """
    if not BAND[1] < 0.5 / model.step:
        raise InputError(f"step: {model.step} s; allowed: below {0.5 / BAND[1]} s")
    frequency, count = np.geomspace(*BAND, _LINES), model.orders.na
    return fit_response(frequency, model.response(frequency)[:, 0, 0], count, count - 1)


def in_field_units(velocity: control.TransferFunction) -> UnitTransferFunction:
    """Leg velocity per command in in/s per %, of one in m/s per full command.

    Its output is named `leg_velocity`, so that `linear.loop.closed_loop` closes a degree of freedom
    with the law like a leg.
    """
    return UnitTransferFunction(
        units.from_si("in/s/%", velocity.num[0][0]),
        velocity.den[0][0],
        input_unit="%",
        output_unit="in/s",
        inputs=velocity.input_labels,
        outputs=["leg_velocity"],
        name=velocity.name,
    )


class LoopErrors(NamedTuple):
    """A model's closed loop and the measured one, in the terms of Table 4-1."""

    model: Measures
    measured: Measures  #: Without a measured step its shape is NaN.

    @property
    def phase_error(self) -> float:
        """Relative error of the -90 deg bandwidth, positive where the model is faster."""
        return self.model.phase_bandwidth_hz / self.measured.phase_bandwidth_hz - 1.0

    @property
    def gain_error(self) -> float:
        """Relative error of the -3 dB bandwidth."""
        return self.model.gain_bandwidth_hz / self.measured.gain_bandwidth_hz - 1.0


def loop_errors(
    velocity: UnitTransferFunction,
    law: str | Law,
    measured: FrequencyResponse,
    step: StepMetrics | None = None,
) -> LoopErrors:
    """Close a velocity model [in/s per %] with a law and compare it with the measured loop.

    `measured` is the response from reference to position under the same law, `step` its measured
    step. A model whose loop is unstable has its response at the measured lines and no step.
    """
    loop = closed_loop(law, velocity)
    model = measure_loop(loop, frequencies=measured.frequency)
    if not model.stable:
        model = joined(bandwidths(loop_response(loop, measured.frequency)))
    return LoopErrors(model, joined(bandwidths(measured), step))
