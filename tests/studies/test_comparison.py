"""The comparison: results, files, reproducibility and refusals."""

import csv
from pathlib import Path

import numpy as np
import pytest

from cmf_mj import bandwidths, compare, load_cab, load_law
from cmf_mj.analysis.measures import Measures
from cmf_mj.record.record import Record
from cmf_mj.show.comparison import AGREEMENT, comparison_table, phase_text, step_figure
from cmf_mj.studies import comparison
from cmf_mj.studies.case import AMPLITUDE, CaseResult, make_case

COLUMNS = [field.name for field in comparison.COMPARISON_FIELDS]


def test_published_values_are_of_the_facility_alone() -> None:
    for machine, known in (("cmf", True), ("simona", False)):
        case = make_case("velocity", "heave", cab=load_cab(machine=machine))
        result = CaseResult(case, None, Measures(), None, 0.0, 0.0)  # type: ignore[arg-type]
        assert (result.published is not None) == known


def test_a_case_runs_on_the_machine_that_is_named() -> None:
    for plant in ("hexapod", "single_legs"):
        case = make_case("velocity", plant=plant, machine="lab")
        assert case.motion_base.name == case.build().machine.name == "lab"
    with pytest.raises(ValueError, match="cab: 'gfd' is one of machine 'cmf', not of 'lab'"):
        make_case("velocity", cab=load_cab("gfd"), machine="lab")


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


@pytest.mark.parametrize("reference", [40.0, 0.05])
def test_a_law_without_position_feedback_drifts(reference: float) -> None:
    """Reference and velocity alone: 40 %/in takes the legs to their stops, where they rest; 0.05
    moves them by less than a step in the run, and a pole at 1 says so."""
    gains = {"reference": reference, "velocity": -2.6}
    law = load_law({"title": "No position", "direct_gain": gains})
    (result,) = compare([law], ["heave"], plants=["single_legs"], quick=True)
    assert (np.abs(result.step["leg_position"][-1]) > 0.95).all() == (reference == 40.0)
    assert not result.measures.stable and np.isnan(result.measures.phase_bandwidth_hz)
    table = comparison_table([result])
    assert table.cells[0][2:7] == ["-", "-", "-", "-", "drifts"]
    assert "drifts: the law holds no position" in table.caption


def test_a_table_explains_what_it_holds() -> None:
    """Marks that occur, sizes of sweeps, and no published columns where nothing is published."""
    for machine, first in (("cmf", "2.55 [2.75]"), ("simona", "~3.44")):
        case = make_case("velocity", "surge", cab=load_cab(machine=machine), amplitude=0.0254)
        measures = Measures(2.55) if machine == "cmf" else Measures(3.44, graze_from_hz=2.93)
        measures = measures._replace(stable=True)
        result = CaseResult(case, None, measures, None, 0.0, 2.75 if "[" in first else 3.44)  # type: ignore[arg-type]
        table = comparison_table([result])
        assert table.cells[0][2] == first
        assert ("[c]:" in table.caption, "~:" in table.caption) == ("[" in first, "~" in first)
        assert "a/b" not in table.caption
        assert table.title.endswith("; simulated sweeps of 1 in, 0.606 deg")
        published = any("published" in title for title in table.header)
        assert not published and "Published" not in table.caption  # none in surge


def test_a_step_is_drawn_whole() -> None:
    """Of a law that is stable, also beyond twice the demand."""
    case = make_case("velocity", "heave", "single_legs")
    step = case.run(case.step(), rate=256)
    channels = {**step.channels, "leg_position": 2.4 * step["leg_position"]}
    large = Record(step.time.copy(), channels, step.units, step.metadata)
    for record, stable in ((step, True), (large, True), (large, False)):
        measures = Measures(stable=stable)
        axes = step_figure([CaseResult(case, None, measures, record, 0.0, 0.0)]).axes[0]
        top = max(line.get_ydata().max() for line in axes.lines[1:])  # type: ignore[union-attr]
        assert (axes.get_ylim()[1] > top) == stable


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
        ({"jobs": 0}, "jobs: 0 is refused; allowed: a whole number from 1"),
    ],
)
def test_bad_arguments_are_named_before_anything_runs(
    arguments: dict[str, object], message: str, tmp_path: Path
) -> None:
    with pytest.raises(ValueError, match=message):
        compare(**arguments, records=tmp_path / "records")  # type: ignore[arg-type]
    assert not (tmp_path / "records").exists()
