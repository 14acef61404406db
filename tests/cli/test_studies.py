"""Commands of studies refuse in a line, before they write anything."""

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cmf_mj.cli.common import app


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("measure", "files: name recordings, or use --simulate"),
        ("measure missing.csv", "missing.csv"),
        ("measure notes.txt", "ending '.txt' is not one of .csv, .parquet"),
        ("measure --simulate --plant boat", "plant: 'boat'"),
        ("measure a.csv --estimator h3", "estimator: 'h3' is not one of h1"),
        ("measure --record --dof up", "dof: 'up' is not one of surge"),
        ("measure --record --law fast", "law: 'fast'"),
        ("measure --record --amplitude '60 in'", "heave"),
        ("failure fire", "event: 'fire' is not one of pump_lost"),
        ("failure overload --size much", "size: 'much' is not a number and a unit"),
        ("failure overload --size '3 in'", "unit 'in' is not one of lbf, N"),
        ("failure all --size '1 in^2'", "size, valve: are for one event"),
        ("failure pump_lost --leg 2", "leg: 2 is not allowed"),
        ("failure pump_lost --jobs 0", "jobs: '0' is refused"),
        ("identify", "not both and not neither"),
        ("identify --simulate --dof up", "'up'"),
        ("identify --simulate --orders 4,3", "orders: '4,3' is refused"),
        ("identify none.csv", "none.csv"),
        ("identify --simulate --plant boat", "'boat'"),
        ("identify --simulate --law fast", "'fast'"),
        ("capacity --signal square", "'square'"),
        ("capacity --dof up", "'up'"),
        ("capacity --amplitude '60 in'", "heave"),
        ("capacity --least-pressure 1600", "least_pressure"),
        ("capacity --law fast", "'fast'"),
        ("capacity --hydraulics water", "'water'"),
        ("certify velocity velocity", "laws: velocity, velocity must differ in name"),
        ("study all", "study: 'all' is not one of"),
    ],
)
def test_what_is_refused(line: str, said: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, [*shlex.split(line), "--out", str(tmp_path / "out")])
    printed = " ".join(result.output.split())
    assert result.exit_code == 2, printed
    assert said in printed and "Traceback" not in printed
    assert not (tmp_path / "out").exists()
