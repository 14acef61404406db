"""Numbers that a change of structure must not move: key values of eighteen runs.

They were written by scripts/compare_behaviour.py, which also compares all records bit for bit at
two commits. Regression, no oracle: the physics is checked elsewhere.
"""

import runpy
import tomllib
from pathlib import Path

import pytest

from cmf_mj.facility.scenario import scenario_of

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "compare_behaviour.py"))
REFERENCES = Path(__file__).parents[1] / "references"
CASES = tomllib.loads((REFERENCES / "behaviour.toml").read_text(encoding="utf-8"))
VALUES = tomllib.loads((REFERENCES / "behaviour_values.toml").read_text(encoding="utf-8"))

TOLERANCE = 1e-3
"""Share of the root mean square: another processor rounds otherwise, converters jump counts."""


@pytest.mark.parametrize("case", CASES)
def test_regression_of_key_values(case: str) -> None:
    record = scenario_of(CASES[case], case).record()
    values = SCRIPT["key_values"](record.channels)
    for name, value in VALUES[case].items():
        size = VALUES[case][name.removesuffix("_last")]
        assert abs(values[name] - value) <= TOLERANCE * size, name
