"""The command line: files, table, refusals."""

import csv
from pathlib import Path

import pytest
from shared import cmf

from cmf_mj.machine.models import machine_names
from cmf_mj.record.record import Record
from cmf_mj.studies.comparison import COMPARISON

MY_LAW = """
[soft]
title = "Half the position gain"
state_gain = 0.914
output_gain = -37.1759
input_gain = { position = 1.0 }
direct_gain = { reference = 23.5, position = 407.04, velocity = -1.0 }
"""


def test_compare_writes_table_figures_and_records(
    tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    law = tmp_path / "mine.toml"
    law.write_text(MY_LAW)
    out = tmp_path / "out"
    output = cmf(
        *("compare", "--laws", f"velocity,{law}", "--dofs", "heave,roll", "--quick"),
        *("--out", out, "--jobs", "2", "--measures"),
    )
    with (out / "comparison.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [field.name for field in COMPARISON]
    keys = [(row["plant"], row["law"], row["dof"]) for row in rows]
    assert keys == [
        (plant, name, dof)
        for plant in ("hexapod", "single_legs")
        for name in ("velocity", "soft")
        for dof in ("heave", "roll")
    ]
    half = {row["law"]: float(row["phase_bandwidth_hz"]) for row in rows if row["dof"] == "heave"}
    assert half["soft"] < half["velocity"]  # the user's gain acts
    assert "soft" in output
    lines = (out / "measures.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 2 + len(rows)
    for row in rows:  # -90 deg over the drive's 3 Hz, two digits
        plant = {"hexapod": "hexapod", "single_legs": "single legs"}[row["plant"]]
        found = next(x for x in lines if x.startswith(f"| {row['law']} | {row['dof']} | {plant}"))
        expected = f"{float(row['phase_bandwidth_hz']) / 3.0:.2f}"
        assert found.split(" | ")[3] == expected
    for dof in ("heave", "roll"):
        for kind in ("bode", "step"):
            laws = {"Velocity FB, hexapod", "Half the position gain, single legs"}
            assert laws <= drawn[f"{kind}_{dof}.png"]
    records = sorted((out / "records").iterdir())
    assert len(records) == 16
    record = Record.load(records[0])
    assert {"leg_reference", "valve_command", "leg_position"} <= set(record.channels)


REFUSED = {
    "compare --laws fast": "'fast'",
    "compare --dofs up": "'up'",
    "compare --cab bus": "'bus'",
    "compare --dofs ,": "names nothing; allowed: one name at least",
    "compare --plants boat": "'boat'",
    "compare --hydraulics missing.toml": "missing.toml",
    "compare --jobs 0": "jobs",
    "compare --jobs two": "jobs: 'two' is refused: input should be a valid integer",
    "compare --laws velocity,velocity": "laws: velocity, velocity must differ in name",
    "fly loop": "cmf: flight: 'loop' is not one of",
    "fly gusts --laws none": "law: 'none'",
    "fly gusts --washout none": "'none'",
    "flight loop --file x.csv": "flight: 'loop' is not one of",
    "flight turn --from telex": "form: 'telex' is not one of",
    "learn gusts --trials 0": "trials: '0' is refused",
    "learn gusts --jobs 0": "jobs: '0' is refused",
    "learn loop": "flight: 'loop' is not one of",
    "learn gusts --law none": "law: 'none'",
    "cue missing.csv": "missing.csv",
    "cue gusts --washout best": "'best'",
    "cue gusts --cab bus": "'bus'",
    "cue gusts --rate 0": "rate",
    "list hydraulics water": "'water'",
    "list laws report": "set: 'report' is of no use to laws; allowed: none",
    "list hydraulics --machine simon": "'simon'",
    "machine new cmf": "is a shipped machine",
}


@pytest.mark.parametrize("line", REFUSED)
def test_a_line_is_refused_in_one_line_and_writes_nothing(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    output = " ".join(cmf(*line.split(), code=2).split())
    assert REFUSED[line] in output and "Traceback" not in output
    assert not list(tmp_path.iterdir())


def test_an_amplitude_of_nothing_is_refused() -> None:
    assert "amplitude" in cmf("compare", "--amplitude", "0 in", code=2)


def test_lists_show_their_sources() -> None:
    assert "Table 2-5" in cmf("list", "laws")
    parameters = cmf("list", "hydraulics", "report")
    for status in ("derived", "assumed", "calibrated"):
        assert status in parameters
    machines, own = cmf("list", "machines"), cmf("list", "hydraulics", "--machine", "simona")
    assert all(name in machines for name in machine_names())
    assert "hydraulics: simona" in own and "160 bar" in " ".join(own.split())
