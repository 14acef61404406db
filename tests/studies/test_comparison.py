"""The comparison: results, files, reproducibility and refusals."""

import csv
from pathlib import Path

import pytest

from cmf_mj import bandwidths, compare, load_cab
from cmf_mj.analysis.measures import Measures
from cmf_mj.record.record import Record
from cmf_mj.show.study import AGREEMENT, comparison_table, phase_text
from cmf_mj.studies import comparison
from cmf_mj.studies.case import AMPLITUDE, CaseResult, make_case

COLUMNS = [field.name for field in comparison.COMPARISON]


def test_published_values_are_of_the_facility_alone() -> None:
    for machine, known in (("cmf", True), ("simona", False)):
        case = make_case("velocity", "heave", cab=load_cab(machine=machine))
        result = CaseResult(case, None, Measures(), None, 0.0, 0.0)  # type: ignore[arg-type]
        assert (result.published is not None) == known


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
        jobs: comparison.save(tmp_path / f"{jobs}.csv").read_bytes()
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
        compare(["velocity"], ["heave"], plants=["single_legs"], quick=quick)[0].measures
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
        with result.save(tmp_path / "c.csv").open(newline="") as file:
            (row,) = csv.DictReader(file)
        assert tuple(float(row[name]) for name in COLUMNS[-3:]) == values
        assert row["hydraulics"] == hydraulics
        assert row["cab"] == ""


def test_a_law_that_rings_has_no_bandwidth_but_its_mark(tmp_path: Path) -> None:
    """Velocity error feedback on single legs of the `report` set, whose oil mode hardly damps."""
    done = compare(
        ["velocity_error"], ["heave"], plants=["single_legs"], hydraulics="report", quick=True
    )
    (result,) = done
    assert result.response is not None
    assert bandwidths(result.response).phase_hz == pytest.approx(4.0, rel=0.05)  # as printed
    with done.save(tmp_path / "c.csv").open(newline="") as file:
        (row,) = csv.DictReader(file)
    assert row["stable"] == "False"
    first, last = COLUMNS.index("phase_bandwidth_hz"), COLUMNS.index("small_motion_phase_hz")
    assert [row[name] for name in COLUMNS[first : last + 1] if name != "stable"] == [""] * 10
    (cells,) = comparison_table(done).cells
    assert cells[:7] == ["velocity_error", "heave", "-", "-", "-", "-", "unstable"]


def test_small_motion_stands_beside_a_sweep_that_is_not() -> None:
    """Surge under the law flown: 2.5 Hz at 0.33 in, where the valves' opening damps, 2.7 Hz small;
    a sweep of a fiftieth agrees."""
    (large,) = compare(["velocity"], ["surge"], plants=["hexapod"], quick=True)
    cells = comparison_table([large]).cells[0]
    first, small = large.measures.phase_bandwidth_hz, large.small_motion_phase_hz
    assert cells[2] == f"{first:.2f} [{small:.2f}]"
    assert cells[5] == f"{47.0 / 50.48:.3f}"  # at rest: the gain of the demand over the position's
    assert small - first > AGREEMENT
    options = {"plants": ["hexapod"], "quick": True, "amplitude": AMPLITUDE / 50.0}
    (tiny,) = compare(["velocity"], ["surge"], **options)  # type: ignore[arg-type]
    assert tiny.small_motion_phase_hz == small
    assert tiny.measures.phase_bandwidth_hz == pytest.approx(small, abs=AGREEMENT)
    assert comparison_table([tiny]).cells[0][2] == f"{tiny.measures.phase_bandwidth_hz:.2f}"


def test_marks_of_a_phase() -> None:
    """Grazing, a later fall, small motion near neither, nothing."""
    grazed = Measures(3.44, graze_from_hz=2.93, graze_to_hz=3.91)
    twice = Measures(2.93, later_phase_hz=3.52, graze_from_hz=2.88, graze_to_hz=3.90)
    assert phase_text(grazed) == "~3.44"
    assert phase_text(grazed, 3.16) == "~3.44 [3.16]"
    assert phase_text(twice) == "2.93/3.52"
    assert phase_text(twice, 3.5) == "2.93/3.52"
    assert phase_text(twice, 3.2) == "2.93/3.52 [3.20]"
    assert phase_text(Measures()) == "-"


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
