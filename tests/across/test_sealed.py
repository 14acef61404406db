"""Sealed predictions: unchanged since, made as they say, and able to tell machines apart."""

import hashlib
import runpy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tomlkit
from shared import rows_of

from cmf_mj import Hexapod, Linear, Record, simulate
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.measurable import dof_history
from cmf_mj.control.law import load_law
from cmf_mj.core.tables import write_csv
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.signals import faded_sines, stepped_sines

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = SimpleNamespace(**runpy.run_path(str(ROOT / "scripts" / "sealed.py"), run_name="sealed"))
SURGE = [one for one in SCRIPT.plan() if (one.test, one.axis) == ("sines", "surge")]
SMALL = [k for k, one in enumerate(SURGE) if one.amplitude < 0.005]
WORSE = Unknowns(
    speed=Unknown(path="hydraulics.leg_speed", low=0.1, high=2.0, unit="1", source="test")
)


def drawn(index: int) -> SimpleNamespace:
    return SCRIPT.of_the_report([rows_of(SCRIPT.MACHINES)[index]])[0]


def test_the_predictions_are_those_whose_digest_readme_states() -> None:
    digest = hashlib.sha256(SCRIPT.SEALED.read_bytes()).hexdigest()
    assert f"`{digest}`" in (ROOT / "README.md").read_text(encoding="utf-8")


def test_every_sine_of_the_plan_is_predicted_once() -> None:
    plan = SCRIPT.plan()
    rows = [row for t, a in {(s.test, s.axis) for s in plan} for row in SCRIPT.sealed(t, a)]
    assert len(rows) == len(plan)
    page = (ROOT / "docs" / "explanation" / "two_machines.md").read_text(encoding="utf-8")
    assert f"on {len(plan)} lines" in page
    assert all(row.gain_low <= row.gain <= row.gain_high for row in rows)
    assert all(row.phase_low <= row.phase <= row.phase_high for row in rows)


def test_without_effects_it_is_the_linear_loops_response() -> None:
    linear, law = Linear(Hexapod()), load_law("velocity")
    found = SCRIPT.describing(SCRIPT.Drawn(linear, law, {}, 1.0), SURGE)
    hertz = np.array([one.frequency for one in SURGE])
    expected = loop_response(linear.loop(law, "surge"), np.unique(hertz)).response
    np.testing.assert_allclose(found, np.tile(expected, 2), rtol=1e-8)


def test_friction_and_motion_twice_as_large_leave_the_response() -> None:
    one, large = drawn(0), [sine._replace(amplitude=2.0 * sine.amplitude) for sine in SURGE]
    once, twice = (one._replace(effects={"coulomb": force}) for force in (1500.0, 3000.0))
    found, same = SCRIPT.describing(once, SURGE), SCRIPT.describing(twice, large)
    np.testing.assert_allclose(same, found, rtol=0.01)  # between speeds 1.8 apart
    assert np.abs(SCRIPT.describing(twice, SURGE) / found - 1.0).max() > 0.05


def recorded(plant: Hexapod, one: SimpleNamespace) -> Record:
    hertz = sorted(SURGE[k].frequency for k in SMALL)
    command = stepped_sines("surge", hertz, [SURGE[SMALL[0]].amplitude], cycles=3, transient=2.0)
    return simulate(plant, one.law, command)


def test_a_machine_of_the_posterior_scores_better_than_a_changed_one() -> None:
    """Simulated, its legs slower by a third."""
    one, rows = drawn(0), [SCRIPT.sealed("sines", "surge")[k] for k in SMALL]
    plant = one.linear.plant
    scores = []
    for machine in (plant, WORSE.apply({"speed": 0.67}, plant)):
        found = SCRIPT.measured(
            *SCRIPT.history(recorded(machine, one), "surge"), [SURGE[k] for k in SMALL]
        )
        assert np.isfinite(found).all()
        scores.append(SCRIPT.score(rows, found))
    own, other = scores
    assert own.gain_inside + own.phase_inside > other.gain_inside + other.phase_inside
    assert own.gain_error < other.gain_error and own.phase_error < other.phase_error


def test_a_log_of_poses_of_simona_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two sines of its profile in heave, simulated and logged at 100 Hz, 20 ms late."""
    sines = [0.9765625, 1.953125], [0.07968222, 0.01992056]
    command = faded_sines(*sines, ["heave"])
    plant = Hexapod(machine="simona")
    record = simulate(plant, plant.machine.law, command)
    time = np.arange(0.0, record.time[-1], 0.01)
    asked, moved = (
        np.interp(time - late, record.time, dof_history(record, name, "heave"))
        for name, late in (("leg_reference", 0.0), ("leg_position", 0.02))
    )
    axes = [f"{what}{axis}" for what in ("c", "m") for axis in range(6)]
    poses = np.zeros((time.size, 12))
    poses[:, [2, 8]] = np.column_stack([asked, moved])
    write_csv(tmp_path / "log.csv", ["t", *axes], np.column_stack([time, poses]).tolist())
    unit = ["m", "m", "m", "rad", "rad", "rad"]
    channels = {"demand_pose": axes[:6], "platform_pose": axes[6:]}
    known = {name: {"columns": names, "unit": unit} for name, names in channels.items()}
    columns = {"time": {"column": "t", "unit": "s"}, "channels": known}
    (tmp_path / "map.toml").write_text(tomlkit.dumps(columns), encoding="utf-8")
    asked_for = ["score", str(tmp_path / "log.csv"), "--columns", str(tmp_path / "map.toml")]
    monkeypatch.setattr(
        "sys.argv", ["sealed.py", *asked_for, "--test", "agard_a", "--axis", "heave"]
    )
    SCRIPT.main()
    said = dict(line.split() for line in capsys.readouterr().out.splitlines())
    assert said["lines"] == "2"
    assert said["gain_inside"] == said["phase_inside"] == "1"
    assert float(said["gain_error"]) < 1.0 and float(said["phase_error"]) < 20.0


@pytest.mark.slow
def test_the_machines_drawn_still_make_the_predictions() -> None:
    """Those of surge at the small amplitude, from all machines, as rounded in the file."""
    sines = [SURGE[k] for k in SMALL]
    machines = SCRIPT.of_the_report(rows_of(SCRIPT.MACHINES))
    made = np.array([SCRIPT.describing(one, sines) for one in machines])
    count = np.array([one.times for one in machines])
    rows = SCRIPT.quantile_rows(sines, made, count, np.ones(len(sines)))
    for row, k in zip(rows, SMALL, strict=True):
        sealed = SCRIPT.sealed("sines", "surge")[k]
        assert row.gain == pytest.approx(sealed.gain, abs=1e-3)
        assert row.phase == pytest.approx(sealed.phase, abs=0.02)
