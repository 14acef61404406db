"""Names of laws, cabs, sets and machines: what they may hold, and that none leaves a folder."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lengths import examples
from shared import cmf

from cmf_mj import InputError, load_law
from cmf_mj.cli.common import show
from cmf_mj.control.law import law_names
from cmf_mj.core.files import plain_path
from cmf_mj.core.settings import checked_name, validated
from cmf_mj.electronics.converter import load_converters
from cmf_mj.electronics.sensors import load_sensors
from cmf_mj.facility.scenario import scenario_names
from cmf_mj.facility.unknowns import with_valve_gains
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.models import CABS
from cmf_mj.pilot.washout_settings import load_washout
from cmf_mj.plant.attach import attach_hydraulics
from cmf_mj.plant.parameters import HYDRAULICS, load_hydraulics
from cmf_mj.report_2014.posterior.run import acceleration_law
from cmf_mj.studies.case import make_case
from cmf_mj.studies.settings import STUDIES, lump_cab

BAD = {
    "up": "../../x",
    "folder": "a/b",
    "backslash": "a\\b",
    "long": "n" * 300,
    "markup": "a[/b]c",
    "hidden": ".x",
    "dots": "..",
    "none": "",
    "blank": " ",
    "option": "-rf",
    "line": "a\nb",
    "last line": "a\n",
    "escape": "a\x1b[31m",
    "null": "a\x00",
    "accent": "é",
    "colon": "a:b",
    "device": "NUL",
    "device with an ending": "con.1",
}


@pytest.mark.parametrize("ending", ["", ".csv", ".TOML"])
@pytest.mark.parametrize("device", ["con", "Prn", "AUX", "nul", "com1", "LPT9"])
def test_a_file_is_no_device_of_windows(device: str, ending: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be a plain name"):
        plain_path(tmp_path, device + ending)
    for name in ("connie", "nullen", "com", "lpt10"):
        assert plain_path(tmp_path, name + ending).parent == tmp_path
        assert checked_name(name) == name


def test_laws_that_differ_in_capitals_alone_would_write_one_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('[Velocity]\nbased_on = "velocity"\ntitle = "another"\n')
    lines = (
        ["compare", "--dofs", "heave", "--laws"],
        ["fly", "gusts", "--laws"],
        ["study", "ablation", "--laws"],
    )
    for line in lines:
        output = cmf(*line, f"velocity,{path}", "--out", tmp_path / "out", code=2)
        said = "laws: velocity, Velocity must differ in name, not in capitals alone"
        assert said in " ".join(output.split()), line
    assert not (tmp_path / "out").exists()


def quoted(name: str) -> str:
    """A TOML key."""
    escapes = {c: f"\\u{ord(c):04x}" for c in map(chr, range(32))} | {'"': '\\"', "\\": "\\\\"}
    return '"' + "".join(escapes.get(c, c) for c in name) + '"'


@pytest.mark.parametrize("name", BAD.values(), ids=BAD)
@pytest.mark.parametrize(
    ("load", "base"),
    [
        (load_law, ""),
        (load_cab, 'base = "gfd"\n'),
        (load_hydraulics, 'base = "report"\n'),
        (load_sensors, 'base = "ideal"\n'),
        (load_converters, ""),
        (load_washout, 'base = "simona"\n'),
    ],
    ids=["law", "cab", "hydraulics", "sensors", "converters", "washout"],
)
def test_a_file_with_such_a_name_is_refused(
    tmp_path: Path, load: Callable[[Path], Any], base: str, name: str
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f"{base}[{quoted(name)}]\n")
    said = f"mine.toml: name of the table: {name!r} is refused: a name has 1 to 64 of the"
    with pytest.raises(InputError, match=re.escape(said)):
        load(path)


@pytest.mark.parametrize("name", BAD.values(), ids=BAD)
def test_so_is_a_name_in_python(name: str) -> None:
    shown = re.escape(repr(name)[:150])  # long ones are cut
    refused = pytest.raises(InputError, match=f"name: {shown}.* is refused: a name has")
    with refused:
        load_law({"name": name, "based_on": "velocity", "title": "t"})
    with refused:
        load_cab().changed(name, mass=9e3)
    for loaded in (load_law("velocity"), load_cab(), load_hydraulics()):
        with refused:
            validated(type(loaded), loaded.model_dump() | {"name": name}, "again")


def test_so_is_the_name_of_a_model() -> None:
    press = mujoco.MjSpec()
    press.modelname = "../press"
    load = press.worldbody.add_body(name="load", mass=2e3, inertia=[1, 1, 1])
    load.explicitinertial = True
    load.add_joint(name="lift", type=mujoco.mjtJoint.mjJNT_SLIDE, range=[-0.5, 0.5])
    with pytest.raises(InputError, match=r"model: name: '../press' is refused: a name has 1 to 64"):
        attach_hydraulics(press, ["lift"])
    press.modelname = "press 3.1"
    assert attach_hydraulics(press, ["lift"]).name == "press 3.1"


def test_all_shipped_and_generated_names_pass() -> None:
    hydraulics = with_valve_gains(load_hydraulics(), 17)
    names = [*law_names("all"), *CABS, *HYDRAULICS, *scenario_names(), *STUDIES]
    names += [acceleration_law(gain, 0.5).name for gain in (-1e-12, 3e8, -0.25)]
    names += [hydraulics.name, lump_cab(load_cab()).name]
    assert [checked_name(name) for name in names] == names


def test_a_name_made_past_the_check_still_leaves_no_folder(tmp_path: Path) -> None:
    """`model_copy` checks nothing; what makes a path of a name does."""
    law = load_law("velocity").model_copy(update={"name": "../../x"})
    case = make_case(law, "heave", "single_legs")
    with pytest.raises(
        InputError, match=r"file: 'single_legs-hardware-../../x-heave.*' is refused"
    ):
        plain_path(tmp_path, f"{case.label}-chirp.parquet")


def test_text_with_brackets_is_printed_as_it_stands(capsys: pytest.CaptureFixture[str]) -> None:
    """Titles are free text, and rich has markup of its own."""
    show("written to a[/b]c: [bold]x")
    assert capsys.readouterr().out == "written to a[/b]c: [bold]x\n"
    show("text alone", unfolded=True)
    assert capsys.readouterr().out == "text alone\n"


TEXT = st.text(max_size=80) | st.text(st.sampled_from("ab/\\.. -_,+[]\x00\n~:é"), max_size=70)


@pytest.mark.fuzz
@settings(max_examples=examples(2000), deadline=None)
@given(names=st.lists(TEXT | st.from_regex(r"\A[\w.,+ -]{1,66}\Z"), min_size=3, max_size=3))
def test_what_is_accepted_never_leaves_a_folder(
    names: list[str], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """As a file, as a folder, and three joined with the longest parts of a label and an ending."""
    folder = tmp_path_factory.getbasetemp()
    try:
        accepted = [checked_name(name) for name in names]
    except InputError:
        return
    label = "-".join(["single_legs", *accepted, "heave"])
    for name in (*accepted, f"{label}-chirp.parquet"):
        path = plain_path(folder, name)
        assert path.parent == folder and path.resolve().parent == folder.resolve()
        partial = path.with_name(f".{name}.{2**22}.part")
        partial.write_text("")
        assert partial in folder.iterdir()
        partial.unlink()


@pytest.mark.fuzz
@settings(max_examples=examples(2000), deadline=None)
@given(name=TEXT)
def test_whatever_becomes_a_path_stays_in_its_folder(name: str) -> None:
    folder = Path("/somewhere/out")
    try:
        path = plain_path(folder, name)
    except InputError:
        return
    assert path.parent == folder and path.name == name and name not in ("", ".", "..")
