"""The whole identification from records to tables, figures and files, and its refusals."""

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from cmf_mj.analysis.identification.data import Experiment
from cmf_mj.analysis.identification.estimation import arx
from cmf_mj.cli.common import app
from cmf_mj.record.columns import write_facility_csv
from cmf_mj.record.record import Record
from cmf_mj.show.fit import model_table, orders_table, save_identification
from cmf_mj.studies import identification
from cmf_mj.studies.case import make_case
from cmf_mj.studies.identification import (
    Identified,
    excitation,
    identify,
    simulated_records,
)

CASE = make_case("velocity", "heave", "single_legs")


@pytest.fixture(scope="module")
def records() -> list[Record]:
    return simulated_records(CASE)


@pytest.fixture(scope="module")
def identified(records: list[Record]) -> Identified:
    step = CASE.run(CASE.step())
    return identify(records, "heave", step=step)


def text(*tables) -> str:
    console = Console(width=150, record=True, file=io.StringIO())
    for table in tables:
        console.print(table)
    return console.export_text()


def test_orders_chosen_on_the_grid_are_those_of_lag_mode_and_leakage(
    identified: Identified,
) -> None:
    """Four poles: drive lag, oil mode and the leakage's slow one; the loop within 3 %."""
    assert identified.model.orders.na == 4
    assert identified.model.method == "oe"
    assert identified.selection is not None
    assert identified.validation_fit > 94.0
    assert identified.loop is not None
    assert abs(identified.loop.phase_error) < 0.03
    assert identified.law == "velocity"
    mine, theirs = identified.loop
    assert mine.damping_ratio == pytest.approx(theirs.damping_ratio, abs=0.03)
    lags = [np.log(r.value.real) * 64.0 for r in identified.model.poles() if r.value.imag == 0.0]
    assert min(lags) == pytest.approx(-2.0 * np.pi * 3.0, rel=0.03)


def test_residuals_do_not_know_the_command_but_distortion_is_not_white(
    identified: Identified,
) -> None:
    """Orifices leave a distortion that a linear model cannot have: not white, not linear in u."""
    assert identified.residuals.cross_outside[0] == 0.0
    auto = identified.residuals.auto[1:]
    assert np.mean(np.abs(auto) > identified.residuals.auto_bound) > 0.5


def test_tables_and_files_say_what_was_identified(
    identified: Identified, tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    printed = text(orders_table(identified), model_table(identified))
    for word in ("validation fit", "pole", "zero", "closed loop, -90 deg", "law velocity"):
        assert word in printed
    paths = save_identification(identified, tmp_path / "out")
    assert [p.name for p in paths] == [
        "model.json",
        "fit.png",
        "residuals.png",
        "bode.png",
    ]
    assert set(drawn) == {path.name for path in paths[1:]}
    saved = json.loads(paths[0].read_text())
    assert saved["denominators"] == identified.model.denominators.tolist()
    assert saved["law"] == "velocity" and saved["closed_loop"]["phase_error"] is not None
    assert saved["output_names"] == ["heave_velocity"] and saved["output_units"] == ["m/s"]


def test_a_single_run_is_split_and_orders_may_be_given(records: list[Record]) -> None:
    alone = identify(records[:1], "leg_2", method="arx", orders=(4, 3, 1))
    assert alone.selection is None
    assert alone.model.method == "arx"
    assert alone.validation.samples == pytest.approx(0.4 * 64.0 * 61.0, abs=2)
    assert alone.validation_fit > 94.0


def test_records_of_a_pulse_alone_have_no_measured_loop() -> None:
    pulse = simulated_records(CASE, "pulse")[:1]
    lone = identify(pulse, "heave", method="arx", orders=(4, 3, 1))
    assert lone.loop is None
    assert lone.response is None
    assert "closed loop" not in text(model_table(lone))


def test_command_line_identifies_recordings_and_simulations_alike(
    records: list[Record], tmp_path: Path
) -> None:
    """Facility CSV files at six decimals give the fit of the run they were written from."""
    files = [write_facility_csv(r, tmp_path / f"{i}.csv") for i, r in enumerate(records)]
    result = CliRunner().invoke(
        app, ["identify", *map(str, files), "--orders", "4,3,1", "--out", str(tmp_path / "out")]
    )
    assert result.exit_code == 0, result.output
    saved = json.loads((tmp_path / "out" / "model.json").read_text())
    direct = identify(records, "heave", orders=(4, 3, 1))
    assert saved["validation_fit"] == pytest.approx(direct.validation_fit, abs=0.05)
    assert saved["law"] == "velocity"


def test_bad_methods_and_signals_are_named(records: list[Record]) -> None:
    with pytest.raises(ValueError, match="method: 'magic' is not one of arx, oe"):
        identify(records, "heave", method="magic")
    with pytest.raises(ValueError, match="records: none given"):
        identify([], "heave")
    with pytest.raises(ValueError, match="signal: 'hum' is not one of multisine"):
        excitation("hum", "heave")


def test_a_pole_at_the_nyquist_frequency_is_refused_and_other_orders_are_taken(
    records: list[Record], identified: Identified, monkeypatch: pytest.MonkeyPatch
) -> None:
    """y+ = -0.98 y + u alternates; no continuous system does."""
    drive = np.random.default_rng(0).normal(size=400)
    out = np.zeros(400)
    for k in range(399):
        out[k + 1] = -0.98 * out[k] + drive[k]
    names = {"input_names": ("u",), "output_names": ("y",)}
    run = Experiment(drive, out, 1.0 / 64.0, input_units=("1",), output_units=("m/s",), **names)
    alternating = arx(run, (1, 1, 1))
    assert alternating.nyquist_poles == pytest.approx((-0.98,))
    assert identified.model.nyquist_poles == ()
    tried = []

    def fit(series, orders):
        tried.append(orders)
        model = arx(series, orders)
        return model if len(tried) > 1 else replace(alternating, orders=orders)

    monkeypatch.setattr(identification, "arx", fit)
    other = identify(records, "heave", method="arx")
    assert len(tried) == 2 and other.model.orders == tried[1] != tried[0]
    assert other.selection.best().orders == tried[1]
    tried.clear()
    with pytest.raises(ValueError, match=r"orders: \(4, 3, 1\) put .* Nyquist frequency of 32 Hz"):
        identify(records, "heave", method="arx", orders=(4, 3, 1))
