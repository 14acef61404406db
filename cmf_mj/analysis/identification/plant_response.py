"""Measured responses from valve command to leg signals of a machine in closed loop.

The law drives the valves, so output over input is not what an open-loop estimator makes of it:
under feedback S_uy / S_uu lies between the plant's response and minus the inverse of the law's.
With the external reference r, which no noise of the loop reaches,

    G = H_ry H_ru^-1

is free of that bias (Soderstrom and Stoica, System Identification, section 12.3): two responses of
the kind `frequency_response` measures. The 95 % radius is the sum of the two relative ones, at most
what the error can be when they add up.
"""

import numpy as np

from cmf_mj.analysis.frequency_response import FrequencyResponse, excited_response
from cmf_mj.analysis.identification.data import experiment
from cmf_mj.analysis.response.spectra import SEGMENT
from cmf_mj.core.errors import InputError
from cmf_mj.record.record import Record

RATE = 128.0
"""Sampling rate of the analysis [Hz], the facility recorder's."""


def plant_response(
    record: Record,
    axis: str,
    *,
    output: str = "leg_velocity",
    segment: float = SEGMENT,
) -> FrequencyResponse:
    """Response from the command at the valve to a leg signal along a leg or degree of freedom.

    The record is of a chirp, noise or multisine along the axis, surge to yaw or leg_1 and so on;
    `output` is a channel, `segment` the length of Welch's segments [s] for records that are not
    periodic. Lines lie in the band of the excitation, in SI per full command; the coherence is the
    lesser of reference to input and reference to output. Raises `InputError` without excitation
    along the axis.
    """
    # The analysis rate, or the record's where it is lower or no multiple.
    factor = record.rate / RATE
    rate = RATE if factor >= 1.0 and abs(factor - round(factor)) < 1e-9 else record.rate
    series = experiment(record, axis, outputs=output, rate=rate)
    if series.reference is None or np.ptp(series.reference[:, 0]) < 1e-9:
        raise InputError(f"axis: the record holds no demand in {axis}")
    to_input, to_output = (
        excited_response(series.reference[:, 0], values[:, 0], series.rate, record.signal, segment)
        for values in (series.input, series.output)
    )
    response = to_output.response / to_input.response
    share = to_output.radius / np.abs(to_output.response) + to_input.radius / np.abs(
        to_input.response
    )
    return FrequencyResponse(
        response,
        2.0 * np.pi * to_input.frequency,
        np.minimum(to_input.coherence, to_output.coherence),
        share * np.abs(response),
        inputs=list(series.input_names),
        outputs=list(series.output_names),
    )
