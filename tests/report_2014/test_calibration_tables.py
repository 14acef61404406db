"""Tables, files and figures of a calibration, and its command."""

from pathlib import Path

import matplotlib.image
import pytest
from typer.testing import CliRunner

from cmf_mj.cli.common import app
from cmf_mj.report_2014.calibration import fit
from cmf_mj.report_2014.calibration import fit as calibration_report
from cmf_mj.report_2014.calibration.fit import (
    Calibration,
    CalibrationStage,
    Examination,
    residual_rows,
    uncertainty,
)
from cmf_mj.report_2014.calibration.trial import (
    StepVerdict,
    least_damping,
    linear_results,
    load_calibration,
    starting_values,
)


@pytest.fixture(scope="module")
def examined() -> Examination:
    """The study `hardware` with linear results in place of simulated ones, nothing fitted."""
    study = load_calibration("hardware")
    values = starting_values(study)
    results = linear_results(study, values, study.laws)
    results["velocity"] = results["velocity"]._replace(gain_bandwidth_hz=float("nan"))
    stage = CalibrationStage(values, results, results, least_damping(study, values))
    later = stage._replace(values=values | {"leg_speed": 0.3512})
    errors = {"leg_speed": 0.011, "leak_rate": 2.5}
    return Examination(
        Calibration(study, (stage, later), errors),
        uncertainty(study, values, samples=3),
        [StepVerdict("gfd", "sway", True, 0.001), StepVerdict("ifd", "surge", False, 0.4)],
    )


def test_files_hold_what_was_computed(examined: Examination, tmp_path: Path) -> None:
    paths = calibration_report.save_calibration(examined, tmp_path / "study")
    assert sorted(path.name for path in paths) == ["calibration.md", "residuals.png"]
    study, stage = examined.calibration.study, examined.calibration.before
    text = (tmp_path / "study" / "calibration.md").read_text(encoding="utf-8")
    lines = [line.split(" | ") for line in text.splitlines() if line.count(" | ") == 9]
    computed = residual_rows(study, stage.simulated)
    assert len(lines) == 2 + len(computed)
    for row, line in zip(computed, lines[2:], strict=True):
        assert (line[0].removeprefix("| "), line[1], line[4]) == (row.table, row.law, row.role)
        if row.stable:
            assert line[6] == ("-" if row.computed != row.computed else f"{row.computed:.2f}")
    picture = matplotlib.image.imread(tmp_path / "study" / "residuals.png")
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.05


def test_text_marks_what_is_outside_and_what_is_missing(examined: Examination) -> None:
    text = calibration_report.markdown(examined)
    assert "| leg_speed | in/s/% | 0.35 | 0.3512 +- 0.011 | 0.286 to 0.4 |" in text
    assert "| bulk_modulus | psi | 1e+05 | held |" in text
    assert "| 2-6 | velocity | h | -3 dB | fitted | 4.00 | - | - | - | - |" in text
    outside = [line for line in text.splitlines() if " ! " in line]
    assert outside
    assert all("combined_rate" in line for line in outside)
    assert "2 step runs with the fitted values: unstable in ifd surge" in text
    assert "largest swing left 40.00 % (ifd, surge)" in text


@pytest.mark.slow
def test_command_writes_a_folder_a_study(
    examined: Examination, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit, "calibrate", lambda *_, **__: examined.calibration)
    monkeypatch.setattr(fit, "examine", lambda *_, **__: examined)
    arguments = ["calibrate", "hardware", "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "residuals of the simulation" in result.output
    assert (tmp_path / "out" / "hardware" / "calibration.md").is_file()
