"""The whole identification from records to tables, figures and files, and its refusals."""

import json
from pathlib import Path

import numpy as np
import pytest
from identified_systems import excited
from typer.testing import CliRunner

from cmf_mj import signals
from cmf_mj.analysis.identification import Identified, arx, experiment, identify
from cmf_mj.cli.common import app
from cmf_mj.record.columns import write_facility_csv
from cmf_mj.record.record import Record
from cmf_mj.show.fit import model_table, save_identification
from cmf_mj.studies.case import make_case

CASE = make_case("velocity", "heave", "single_legs")


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return excited(CASE)


@pytest.fixture(scope="module")
def identified(records: list[Record]) -> Identified:
    return identify(records, "heave")


def test_orders_by_default_are_those_of_lag_mode_and_leakage(identified: Identified) -> None:
    """Four poles: drive lag, oil mode and the leakage's slow one."""
    assert identified.box.orders.na == 4 and identified.validation_fit > 94.0
    lags = [pole.hertz for pole in identified.box.poles() if pole.value.imag == 0.0]
    assert max(lags) == pytest.approx(3.0, rel=0.03)


def test_tables_and_files_say_what_was_identified(
    identified: Identified, tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    printed = {row[0] for row in model_table(identified).rows}
    assert {"fit, validation", "pole"} <= printed
    paths = save_identification(identified, tmp_path / "out")
    assert [p.name for p in paths] == ["model.json", "bode.png"]
    assert set(drawn) == {path.name for path in paths[1:]}
    saved = json.loads(paths[0].read_text())
    assert saved["denominator"] == identified.box.denominator.tolist()
    assert saved["names"] == ["heave_command", "heave_velocity"] and saved["stable"]


def test_a_single_run_is_split_and_orders_may_be_given(records: list[Record]) -> None:
    alone = identify(records[:1], "leg_2", (5, 4, 1))
    assert alone.box.orders == (5, 4, 1) and alone.validation_fit > 94.0
    first, rest = experiment(records[0], "leg_2").split(0.6)
    assert rest.output.size == pytest.approx(0.4 * 64.0 * 61.0, abs=2)
    assert np.array_equal(arx([first], (5, 4, 1)).parameters, alone.box.parameters)


def test_records_of_a_pulse_alone_have_no_measured_response() -> None:
    lone = identify([CASE.run(signals.pulse("heave", CASE.size))], "heave")
    assert lone.response is None


def test_command_line_identifies_recordings(records: list[Record], tmp_path: Path) -> None:
    """Facility CSV files at six decimals give the fit of the run they were written from."""
    files = [write_facility_csv(r, tmp_path / f"{i}.csv") for i, r in enumerate(records)]
    result = CliRunner().invoke(
        app, ["identify", *map(str, files), "--orders", "4,3,1", "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 0, result.output
    saved = json.loads((tmp_path / "out" / "model.json").read_text())
    direct = identify(records, "heave")
    assert saved["validation_fit"] == pytest.approx(direct.validation_fit, abs=0.05)


def test_no_records_are_refused() -> None:
    with pytest.raises(ValueError, match="records: none given"):
        identify([], "heave")
