"""`--cab mine.toml`: a cab of the user's in every command that takes one."""

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from shared import cmf, rows_of

import cmf_mj
from cmf_mj.core import units
from cmf_mj.machine.cab import load_cab, recorded_cab
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.record.record import Record
from cmf_mj.show.player.play import model_of

EXAMPLE = Path(__file__).parents[2] / "examples" / "cab_of_your_own.toml"


@pytest.fixture
def mine() -> str:
    return str(EXAMPLE)


def test_compare(mine: str, tmp_path: Path) -> None:
    """Heavier and higher: the surge mode falls, and with it the -3 dB bandwidth."""
    options = ("compare", "--laws", "velocity", "--dofs", "surge", "--plants", "hexapod", "--quick")
    output = cmf(*options, "--cab", mine, "--out", str(tmp_path / "mine"))
    cmf(*options, "--out", str(tmp_path / "gfd"))
    assert "cab: heavy_cab" in output
    (own,), (shipped,) = (rows_of(tmp_path / c / "comparison.csv") for c in ("mine", "gfd"))
    assert (own["cab"], shipped["cab"]) == ("heavy_cab", "gfd")
    assert float(own["gain_bandwidth_hz"]) < float(shipped["gain_bandwidth_hz"])
    records = sorted((tmp_path / "mine" / "records").iterdir())
    assert records[0].name == "hexapod-heavy_cab-hardware-velocity-surge-chirp.parquet"
    record = Record.load(records[0])
    assert record.metadata["cab"] == "heavy_cab"
    assert recorded_cab(record.metadata) == load_cab(EXAMPLE)
    drawn = model_of(record)
    assert drawn.body("cab/cab").mass[0] == load_cab(EXAMPLE).mass.si


def test_study(mine: str, tmp_path: Path) -> None:
    """Cabs of a file; modes of the user's cab for the law in modes."""
    study = tmp_path / "study.toml"
    study.write_text(
        'title = "two cabs"\nmethod = "linear"\nlaws = ["velocity", "modal_plan"]\n'
        f'cabs = ["gfd", "{mine}"]\n'
    )
    cmf("study", str(study), "--jobs", "1", "--out", str(tmp_path / "out"))
    table = pq.read_table(tmp_path / "out" / "results.parquet").to_pylist()
    assert [row["cab"] for row in table] == ["gfd"] * 12 + ["heavy_cab"] * 12
    assert all(row["stable"] and not row["error_message"] for row in table)
    surge = [
        r["mode_frequency_hz"] for r in table if r["law"] == "velocity" and r["dof"] == "surge"
    ]
    assert surge[1] < surge[0]
    changed = tmp_path / "changed.toml"
    changed.write_text(EXAMPLE.read_text().replace("24000", "25000"))
    options = ("study", str(study), "--jobs", "1", "--out", str(tmp_path / "out"))
    cmf(*options, "--cabs", f"gfd,{mine}")  # the same one: nothing is left to run
    assert "another" in cmf(*options, "--cabs", f"gfd,{changed}", code=2)
    assert "heavy_cab, heavy_cab must differ in name" in cmf(
        *options, "--cabs", f"{mine},{changed}", code=2
    )


def test_failure(mine: str, tmp_path: Path) -> None:
    """Loads are counted in the static load of the cab that is there."""
    options = ("failure", "sensor_stuck", "--at", "1", "--after", "4", "--jobs", "1")
    cmf(*options, "--cab", mine, "--out", str(tmp_path))
    (row,) = rows_of(tmp_path / "failures.csv")
    assert row["cab"] == "heavy_cab"
    plant = Hexapod(mine)
    plant.start()
    static = plant.static_load()[int(row["load_before_leg"]) - 1]
    counted = float(row["load_before_n"]) / float(row["load_before_multiple"])
    assert counted == pytest.approx(static, rel=1e-6)


def test_run(mine: str, tmp_path: Path) -> None:
    scenario = tmp_path / "mine.toml"
    scenario.write_text(f'law = "modal_plan"\ncab = "{mine}"\nduration = 0.5\n')
    cmf("run", str(scenario), "--out", str(tmp_path / "out"))
    record = Record.load(tmp_path / "out" / "record.parquet")
    assert list(record.metadata["law_parameters"]["modes"]) == ["heavy_cab"]
    assert record.metadata["scenario"]["cab"] == mine
    scenario.write_text("duration = 0.1\n")
    cmf("run", str(scenario), "--cab", mine, "--out", str(tmp_path / "other"))
    other = Record.load(tmp_path / "other" / "record.parquet")
    assert other.metadata["cab"] == "heavy_cab"
    plant = Hexapod(mine)
    plant.start()
    assert other["leg_force"][0] == pytest.approx(plant.static_load(), rel=1e-3)


def test_the_pilot_sits_where_he_sits_in_the_base(mine: str) -> None:
    assert np.array_equal(load_cab(mine).station, load_cab("gfd").station)


@pytest.mark.parametrize(
    "arguments",
    [
        ("compare",),
        ("study", "rotation"),
        ("modes",),
        ("failure", "pump_lost"),
        ("run", "heave_sine"),
        ("linearize",),
        ("play",),
        ("tune",),
    ],
)
def test_a_cab_that_cannot_be_is_one_clear_error(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    bad = tmp_path / "bad.toml"
    why = 'status = "assumed", source = "test"'
    bad.write_text(
        f'base = "gfd"\n[bad]\ninertia = {{ value = [1, 1, 3], unit = "kg m^2", {why} }}\n'
    )
    option = "--cabs" if arguments[0] in ("modes", "study", "tune") else "--cab"
    output = cmf(*arguments, option, str(bad), code=2)
    assert "bad.toml: bad: inertia: principal moments are 1, 1, 3 kg m^2" in output
    assert "Traceback" not in output


def test_the_page_shows_a_file_that_loads(tmp_path: Path) -> None:
    page = (EXAMPLE.parents[1] / "docs" / "how_to" / "cabs.md").read_text()
    text = page.split("```toml\n")[1].split("```")[0]
    (tmp_path / "mine.toml").write_text(text)
    shown, example = load_cab(tmp_path / "mine.toml"), load_cab(EXAMPLE)
    assert shown.payload.mass == example.payload.mass
    assert shown.tensor == pytest.approx(example.tensor)
    assert example.mass.si == pytest.approx(24000 * units.POUND_MASS)
    assert cmf_mj.Hexapod(shown).cab == "mine"
