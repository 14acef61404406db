"""Frequency responses from sampled inputs and outputs: estimators with honest bounds."""

from cmf_mj.analysis.response.estimate import (
    CONFIDENCE,
    DRIVEN,
    NEIGHBOURS,
    SEGMENT,
    Estimate,
    Estimator,
)
from cmf_mj.analysis.response.matrix import matrix_response, stitch
from cmf_mj.analysis.response.periodic import periodic_response, sine_response
from cmf_mj.analysis.response.spectra import effective_averages
from cmf_mj.analysis.response.welch import from_h1, report_response, welch_response

__all__ = [
    "CONFIDENCE",
    "DRIVEN",
    "NEIGHBOURS",
    "SEGMENT",
    "Estimate",
    "Estimator",
    "effective_averages",
    "from_h1",
    "matrix_response",
    "periodic_response",
    "report_response",
    "sine_response",
    "stitch",
    "welch_response",
]
