"""Recordings measured in the field's terms."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast, get_args

from cmf_mj.analysis.frequency_response import (
    FrequencyResponse,
    bandwidths,
    frequency_response,
    rounds_response,
)
from cmf_mj.analysis.metrics import SecondOrder, fit_second_order
from cmf_mj.analysis.response.estimate import Estimator
from cmf_mj.core.errors import check_name
from cmf_mj.record.reader import read_recording


class RecordingMeasures(NamedTuple):
    """The response of a degree of freedom in one recording or several rounds."""

    files: tuple[Path, ...]
    dof: str
    estimator: str
    response: FrequencyResponse
    second_order: SecondOrder

    def summary(self) -> dict[str, Any]:
        """Files, settings and measures."""
        return {
            "files": [str(path) for path in self.files],
            "dof": self.dof,
            "estimator": self.estimator,
            "bandwidths": bandwidths(self.response)._asdict(),
            "second_order": self.second_order._asdict(),
            "coherence_least": float(self.response.coherence.min()),
        }


def measure_recordings(files: Sequence[Path], dof: str, estimator: str) -> RecordingMeasures:
    """Measure the response in recordings; several, or one of single sines, are rounds of one."""
    check_name("estimator", estimator, get_args(Estimator))
    records = [read_recording(path) for path in files]
    if len(records) > 1 or records[0].signal.dwells:
        response = rounds_response(records, dof)
    else:
        response = frequency_response(records[0], dof, estimator=cast("Estimator", estimator))
    fit = fit_second_order(response.frequency, response.response)
    return RecordingMeasures(tuple(files), dof, estimator, response, fit)
