"""The comparison: results, files, reproducibility and refusals."""

import csv
from pathlib import Path

import pytest

from cmf_mj import compare
from cmf_mj.record.record import Record
from cmf_mj.studies import comparison

COLUMNS = (
    "plant,cab,hydraulics,law,dof,phase_bandwidth_hz,gain_bandwidth_hz,peak_gain_db,damping_ratio,"
    "overshoot,steady_state_error,stable,published_phase_bandwidth_hz,"
    "published_gain_bandwidth_hz,published_damping_ratio"
).split(",")


def test_columns_are_the_promised_ones() -> None:
    assert list(comparison.COLUMNS) == COLUMNS


@pytest.mark.slow
def test_results_are_bit_identical_whatever_the_jobs(tmp_path: Path) -> None:
    comparisons = {
        jobs: compare(
            ["velocity", "position_error_rate"],
            ["surge", "yaw"],
            jobs=jobs,
            quick=True,
            records=tmp_path / str(jobs),
        )
        for jobs in (1, 2)
    }
    tables = {
        jobs: comparison.save_csv(tmp_path / f"{jobs}.csv").read_bytes()
        for jobs, comparison in comparisons.items()
    }
    assert tables[1] == tables[2]
    names = sorted(path.name for path in (tmp_path / "1").iterdir())
    assert len(names) == 16  # two laws, two degrees of freedom, two plants, chirp and step
    assert names == sorted(path.name for path in (tmp_path / "2").iterdir())
    for name in names:
        one, two = (Record.load(tmp_path / jobs / name) for jobs in ("1", "2"))
        assert dict(one.metadata) == dict(two.metadata)
        for channel in one.channels:
            assert one[channel].tobytes() == two[channel].tobytes(), (name, channel)


@pytest.mark.slow
def test_quick_sweep_reads_the_same_bandwidths() -> None:
    """A sweep three times as fast: within 2 % on a damped response, as the docstring says."""
    quick, full = (
        compare(["velocity"], ["heave"], plants=["single_legs"], quick=quick).results[0].measures
        for quick in (True, False)
    )
    assert quick.phase_bandwidth_hz == pytest.approx(full.phase_bandwidth_hz, rel=0.02)
    assert quick.gain_bandwidth_hz == pytest.approx(full.gain_bandwidth_hz, rel=0.02)


def test_published_values_stand_beside_ours(tmp_path: Path) -> None:
    """Table 2-6, hardware, for the hardware set; Table 3-5 for the report set."""
    for hydraulics, values in (("hardware", (2.94, 4.0, 0.4)), ("report", (2.5, 3.25, 0.48))):
        result = compare(
            ["velocity"], ["heave"], plants=["single_legs"], hydraulics=hydraulics, quick=True
        )
        with result.save_csv(tmp_path / "c.csv").open(newline="") as file:
            (row,) = csv.DictReader(file)
        assert tuple(float(row[name]) for name in COLUMNS[-3:]) == values
        assert row["hydraulics"] == hydraulics
        assert row["cab"] == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"laws": ["fast"]}, "law: 'fast' is not one of original"),
        ({"dofs": ["up"]}, "dofs: 'up' is not one of surge"),
        ({"dofs": []}, "dofs: is empty"),
        ({"laws": []}, "laws: is empty"),
        ({"plants": ["boat"]}, "plants: 'boat' is not one of hexapod, single_legs"),
        ({"cab": "bus"}, "cab: 'bus' is not one of gfd, rfd, ifd"),
        (
            {"hydraulics": "water"},
            "hydraulics: 'water' is not one of report, hardware, lossy nor a .toml",
        ),
        ({"amplitude": -1.0}, "amplitude: -1.0 m must be greater than 0"),
        ({"jobs": 0}, "jobs: 0 must be at least 1"),
    ],
)
def test_bad_arguments_are_named_before_anything_runs(
    arguments: dict[str, object], message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        compare(**arguments, records=tmp_path / "records")  # type: ignore[arg-type]
    assert not (tmp_path / "records").exists()
