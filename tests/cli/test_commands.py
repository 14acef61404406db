"""The command line: files, table, refusals."""

import csv
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cmf_mj.cli.common import app
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


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, result.output


def test_compare_writes_table_figures_and_records(
    tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    law = tmp_path / "mine.toml"
    law.write_text(MY_LAW)
    out = tmp_path / "out"
    code, output = run(
        *("compare", "--laws", f"velocity,{law}", "--dofs", "heave,roll", "--quick"),
        *("--out", str(out), "--jobs", "2", "--measures"),
    )
    assert code == 0, output
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--laws", "fast"), "'fast'"),
        (("--dofs", "up"), "'up'"),
        (("--cab", "bus"), "'bus'"),
        (("--dofs", " , "), "names nothing; allowed: one name at least"),
        (("--plants", "boat"), "'boat'"),
        (("--hydraulics", "missing.toml"), "missing.toml"),
        (("--amplitude", "0 in"), "amplitude"),
        (("--jobs", "0"), "jobs"),
        (("--jobs", "two"), "jobs: 'two' is refused: input should be a valid integer"),
        (("--laws", "velocity,velocity"), "laws: velocity, velocity must differ in name"),
    ],
)
def test_compare_refuses_in_one_line_and_writes_nothing(
    arguments: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    code, output = run("compare", *arguments, "--out", str(out))
    assert code == 2
    assert message in output
    assert "Traceback" not in output
    assert not out.exists()


def test_laws_and_parameters_show_their_sources() -> None:
    code, laws = run("laws")
    assert code == 0
    assert "Table 2-5" in laws
    code, parameters = run("parameters", "report")
    assert code == 0
    for status in ("derived", "assumed", "calibrated"):
        assert status in parameters
    code, refused = run("parameters", "water")
    assert code == 2
    assert "'water'" in refused
