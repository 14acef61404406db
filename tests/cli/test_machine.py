"""`cmf machine` and `--machine`: a file from the template to a model, and what does not fit."""

from pathlib import Path

import mujoco
import numpy as np
import pyarrow.parquet
import pytest
from shared import cmf
from typer.main import get_command

from cmf_mj import Hexapod, Record
from cmf_mj.cli.common import app
from cmf_mj.studies.settings import load_study

TAKING = ("cab", "cabs", "hydraulics")


def run(*arguments: object, code: int = 0) -> str:
    return " ".join(cmf("machine", *arguments, code=code).split())


def test_a_new_machine_is_checked_and_built(tmp_path: Path) -> None:
    """The template fits together; its MJCF is the model that runs."""
    file, out = tmp_path / "mine.toml", tmp_path / "model"
    assert run("new", "mine", "--file", file) == f"written: {file}"
    said = run("check", file)
    assert "does not fit" not in said, said
    assert "neutral legs 1.0366 to 1.0366 m" in said and "assumed: hydraulics.bore_diameter" in said
    run("build", file, "--out", out)
    model = mujoco.MjModel.from_xml_path(str(out / "scene.xml"))
    drawn = Hexapod(machine=file).drawn_model
    for field in ("body_mass", "body_pos", "body_inertia", "site_pos", "jnt_range"):
        np.testing.assert_allclose(getattr(model, field), getattr(drawn, field), atol=1e-12)


def test_what_does_not_fit_is_told(tmp_path: Path) -> None:
    """A payload a hundred times too heavy, and legs asked for more speed than their valves give."""
    file = tmp_path / "mine.toml"
    run("new", "mine", "--file", file)
    text = file.read_text()
    file.write_text(text.replace("value = 300,", "value = 30000,"))
    said = run("check", file, code=2)
    assert "cabs.payload: static load of leg 1: " in said and "cannot be held by a supply" in said
    file.write_text(text.replace("value = 0.4,", "value = 4.0,"))
    assert "limits.leg.velocity asks for 4 m/s" in run("check", file, code=1)


def test_a_new_machine_writes_over_no_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("# a day's work")
    assert "exists and is kept" in run("new", "mine", "--file", file, code=2)
    assert file.read_text() == "# a day's work"


@pytest.mark.parametrize("command", ["compare", "linearize", "operate", "fly", "tune", "serve"])
def test_commands_that_build_a_machine_take_one(command: str) -> None:
    parameters = [p.name for p in get_command(app).commands[command].params]  # type: ignore[attr-defined]
    assert "machine" in parameters and set(TAKING) & set(parameters)


def test_the_law_of_a_machine_file_goes_by_its_name(tmp_path: Path) -> None:
    """`cmf list machines` names it; the machine's file says where it is."""
    how = ("--machine", "lab", "--dofs", "heave", "--out", tmp_path)
    said = cmf("linearize", "--law", "lab_plan", *how)
    assert said == cmf("linearize", *how)
    assert "'lab_plan' is not one of" in cmf("linearize", "--law", "lab_plan", code=2)
    assert "'lab_pla' is not one of" in cmf("linearize", "--law", "lab_pla", *how, code=2)


def test_a_study_knows_laws_and_cabs_of_any_machine(tmp_path: Path) -> None:
    table = {"title": "own", "method": "linear", "machine": "lab", "laws": ["lab_plan"]}
    study = load_study(table | {"cabs": ["all"]})
    assert [one.name for one in (*study.laws, *study.cabs)] == ["lab_plan", "payload"]
    file = tmp_path / "own.toml"
    file.write_text('title = "own"\nmethod = "linear"\nlaws = ["velocity"]\n')
    how = ("--jobs", 1, "--backend", "threading", "--out", tmp_path / "out")
    said = cmf("study", file, "--machine", "lab", "--laws", "lab_plan", "--cabs", "all", *how)
    assert "lab_plan" in said
    rows = pyarrow.parquet.read_table(tmp_path / "out" / "results.parquet")
    assert set(rows["cab"].to_pylist()) == {"payload"}


def test_a_scenario_takes_machine_and_cab(tmp_path: Path) -> None:
    refused = cmf("play", "heave_sine", "--machine", "lab", "--cab", "gfd", code=2)
    assert "cab: 'gfd'" in refused
    cmf("run", "heave_sine", "--machine", "lab", "--cab", "payload", "--out", tmp_path)
    begun = Record.load(tmp_path / "record.parquet").metadata
    assert (begun["law"], begun["cab"]) == ("lab_plan", "payload")
