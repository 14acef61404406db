"""Tables, figures and files of `cmf report linear`."""

import csv
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cmf_mj.analysis.published import published_results
from cmf_mj.cli.common import app
from cmf_mj.core.errors import InputError
from cmf_mj.report_2014.model_tables import law_loops, loop_figures, table_4_1


def test_linear_prints_the_tables_and_writes_the_files(
    tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(
        app, ["report", "linear", "--laws", "velocity,original", "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    with (out / "table_4_1.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 15
    printed = {row.of: row for row in published_results() if row.table == "4-1"}
    for row in rows:
        of = printed[f"linear_{row['model']}"]
        expected = {"-90 deg": of.phase_bandwidth_hz, "-3 dB": of.gain_bandwidth_hz}
        value = expected.get(row["quantity"], of.damping_ratio)
        assert float(row["published"]) == value
        off = abs(float(row["computed"]) - float(row["published"]))
        assert row["within"] == str(off <= float(row["tolerance"]))
    pictures = sorted(path.stem for path in out.glob("*.png"))
    assert pictures == ["bode_original", "bode_velocity", "step_original", "step_velocity"]
    assert set(drawn) == {f"{name}.png" for name in pictures}


def test_table_4_1_says_what_lies_outside() -> None:
    rows = table_4_1()
    words = [row[-1] for row in rows.table.cells]
    assert words == ["within" if row.within else "OUTSIDE" for row in rows]


@pytest.mark.parametrize(("law", "models"), [("velocity", (1, 2, 3)), ("original", ())])
def test_published_bandwidths_lie_on_the_bode_diagram(law: str, models: tuple[int, ...]) -> None:
    """A circle at -3 dB and one at -90 deg for each model of the velocity law, none for others."""
    bode, step = loop_figures(law_loops(law))
    printed = {row.of: row for row in published_results() if row.table == "4-1"}
    for axis, level, name in zip(
        bode.axes, (-3.0, -90.0), ("gain_bandwidth_hz", "phase_bandwidth_hz"), strict=True
    ):
        marks = [line for line in axis.lines if line.get_marker() == "o"]
        widths = [float(line.get_xdata()[0]) for line in marks]
        assert widths == [getattr(printed[f"linear_{n}"], name) for n in models]
        assert {float(line.get_ydata()[0]) for line in marks} <= {level}
    assert ("circles" in bode.axes[0].get_title()) == bool(models)
    assert len(step.axes[0].lines) == 4  # three steps and the demand


def test_figures_of_no_loop_are_refused() -> None:
    with pytest.raises(InputError, match="loops: none given"):
        loop_figures([])
