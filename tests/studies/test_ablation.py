"""`cmf study ablation` climbs the ladder and writes its table and figure."""

import csv
from pathlib import Path

import matplotlib.image
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from cmf_mj.cli.common import app
from cmf_mj.studies.engine import RESULTS
from cmf_mj.studies.settings import LADDER


@pytest.mark.slow
def test_heave_keeps_its_single_leg_all_the_way_up(tmp_path: Path) -> None:
    """One degree of freedom, one law: the -90 deg bandwidth of every rung within 4 % of the first.

    Nothing but heave moves before the centre of mass leaves the centroid, in front of the legs'
    axis of symmetry.
    """
    arguments = ["study", "ablation", "--laws", "velocity", "--dofs", "heave"]
    arguments += ["--out", str(tmp_path)]
    done = CliRunner().invoke(app, [*arguments, "--jobs", "2", "--backend", "threading"])
    assert done.exit_code == 0, done.output
    rows = pq.read_table(tmp_path / RESULTS).to_pylist()
    assert [row["rung"] for row in rows] == [rung.name for rung in LADDER]
    for row in rows:
        assert row["stable"]
        assert row["phase_bandwidth_hz"] == pytest.approx(rows[0]["phase_bandwidth_hz"], rel=0.04)
        apart = row["rung"] in ("single_legs", "point_mass", "payload_inertia")
        assert (row["crosstalk_pitch"] < 1e-3) == apart, row["rung"]
    with (tmp_path / "effects.csv").open(newline="") as file:
        lines = list(csv.reader(file))
    assert lines[0] == ["adds", "heave"]
    assert [line[0] for line in lines[1:]] == [rung.name for rung in LADDER[1:]]
    picture = matplotlib.image.imread(tmp_path / "ladder.png")
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.02
