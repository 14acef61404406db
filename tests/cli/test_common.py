"""The command line: files, table, refusals."""

from pathlib import Path

from shared import cmf, rows_of

from cmf_mj.machine.models import machine_names
from cmf_mj.record.record import Record
from cmf_mj.studies.comparison import COMPARISON_FIELDS

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
    (out / "records").mkdir(parents=True)
    mine = {"bode_mine.png", "step_heave.png.old", "records/mine-heave-step.parquet"}
    stale = {"bode_yaw.png", "step_heave.svg", "records/hexapod-gfd-lossy-soft-heave-step.parquet"}
    for name in mine | stale:
        (out / name).touch()
    output = cmf(
        *("compare", "--laws", f"velocity,{law}", "--dofs", "heave,roll", "--quick"),
        *("--out", out, "--jobs", "2"),
    )
    rows = rows_of(out / "comparison.csv")
    assert list(rows[0]) == [field.name for field in COMPARISON_FIELDS]
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
    for dof in ("heave", "roll"):
        for kind in ("bode", "step"):
            laws = {"velocity, hexapod", "soft, single legs"}
            assert laws <= drawn[f"{kind}_{dof}.png"]
    assert "removed first: 3 files of an earlier comparison" in output
    left = {str(path.relative_to(out)) for path in out.rglob("*")}
    assert mine <= left and not stale & left
    (out / "records" / "mine-heave-step.parquet").unlink()
    records = sorted((out / "records").iterdir())
    assert len(records) == 16
    record = Record.load(records[0])
    assert {"leg_reference", "valve_command", "leg_position"} <= set(record.channels)


def test_lists_show_their_sources() -> None:
    assert "Table 2-5" in cmf("list", "laws")
    parameters = cmf("list", "hydraulics", "report")
    for status in ("derived", "assumed", "calibrated"):
        assert status in parameters
    machines, own = cmf("list", "machines"), cmf("list", "hydraulics", "--machine", "simona")
    assert all(name in machines for name in machine_names())
    assert "hydraulics: simona" in own and "160 bar" in " ".join(own.split())
