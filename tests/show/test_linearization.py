"""Tables, figures and files of `cmf linearize`."""

import json
from pathlib import Path

import numpy as np
import pytest
from shared import cmf, rows_of

from cmf_mj import Hexapod
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.cli.common import pose_option
from cmf_mj.core import units
from cmf_mj.machine.geometry import DOFS, pose_text
from cmf_mj.show.linearization import linearization_study, loop_table, mode_names, pole_table


def test_linearize_prints_the_tables_and_writes_the_files(
    tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    out = tmp_path / "out"
    text = cmf("linearize", "--dofs", "surge,leg_2", "--pose", "0,0,-5,0,3,0", "--out", out)
    assert "heave -5 in, pitch 3 deg" in text
    pose = np.array([0.0, 0.0, -5 * 0.0254, 0.0, np.radians(3.0), 0.0])
    expected = linearize(Hexapod("gfd"), pose)
    loaded = json.loads((out / "state_space.json").read_text(encoding="utf-8"))
    np.testing.assert_allclose(loaded["A"], expected.A, rtol=1e-12, atol=1e-12)
    rows = rows_of(out / "modes.csv")
    poles = [int(row["times"]) * (2 if "±" in row["pole [rad/s]"] else 1) for row in rows]
    assert sum(poles) == expected.nstates
    assert set(drawn) == {"bode.png", "loop.png"}


def test_poles_that_coincide_share_a_line() -> None:
    study = linearization_study(Linear(Hexapod("gfd"), np.zeros(6)), "velocity", ["heave"])
    times = [int(row[3]) for row in pole_table(study).cells]
    assert sum(times) == len(study.modes)
    assert times.count(6) == 3  # integrators, drives, spools


def test_a_pose_reads_in_inches_and_degrees() -> None:
    pose = pose_option("1,0,-2,3,0,-4")
    assert pose[0] == pytest.approx(units.INCH) and pose[5] == pytest.approx(np.radians(-4.0))
    assert pose_text(pose) == "surge 1 in, heave -2 in, roll 3 deg, yaw -4 deg"


def test_a_mode_is_named_by_what_moves_in_it() -> None:
    modes = Hexapod("gfd").hydraulic_modes()
    assert mode_names(modes._replace(share=np.eye(6))) == list(DOFS)
    mixed = np.eye(6) * 0.7
    mixed[(4, 3), (0, 1)], mixed[5, :2], mixed[4, 5] = 0.2, 0.1, 0.04
    named = mode_names(modes._replace(share=mixed))
    assert named == ["surge with pitch", "sway with roll", *DOFS[2:]]


def test_a_loop_that_grows_is_named_with_its_frequency() -> None:
    """The law flown rings on SIMONA; the poles of its loop say where."""
    linear = Linear(Hexapod(machine="simona"))
    study = linearization_study(linear, "velocity", ["surge"])
    loop = linear.loop("velocity", "surge")
    grows = np.log(loop.poles()[np.abs(loop.poles()).argmax()]) / loop.dt
    said = loop_table(study).caption
    assert grows.real > 0.0 and not study.stable
    assert f"motion at {abs(grows) / (2.0 * np.pi):.2f} Hz grows" in said
    stable = linearization_study(Linear(Hexapod("gfd")), "velocity", ["heave"])
    assert "grows" not in loop_table(stable).caption
