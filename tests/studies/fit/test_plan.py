"""Plans of campaigns stay within the machine, and recordings tell nothing but what was recorded."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit

import cmf_mj
from cmf_mj.core.settings import read_toml
from cmf_mj.facility.host.stream import read_stream
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.machine import models
from cmf_mj.machine.kinematics import pose_to_legs
from cmf_mj.machine.machine import recorded_machine
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.studies.fit.campaign import load_campaign
from cmf_mj.studies.fit.plan import demand, plan_campaign, record_campaign

SHARE = 0.4


def machine_with_friction(folder: Path) -> Path:
    """The laboratory machine, rubbing."""
    table = read_toml(models.directory() / "machines" / "lab.toml") | {"name": "rubbing"}
    rubbing = {"unit": "N", "status": "assumed", "source": "worn seals"}
    for field, force in (("coulomb_friction", 60.0), ("breakaway_friction", 90.0)):
        table["hydraulics"][field] = rubbing | {"value": force}
    path = folder / "rubbing.toml"
    path.write_text(tomlkit.dumps(table | {"law": "original"}), encoding="utf-8")
    return path


def planned(machine: str | Path, law: str | None, folder: Path) -> dict[str, Any]:
    """The table of a plan of ten seconds a recording."""
    target = folder / "campaign"
    return read_toml(plan_campaign(machine, None, None, law, target, seconds=10.0, share=SHARE))


@pytest.mark.parametrize("name", ["cmf", "simona", "lab", "friction"])
def test_plan_stays_within_stroke_speed_and_acceleration(name: str, tmp_path: Path) -> None:
    """Of each leg, from the poses that the scenario and the host's file make."""
    machine = machine_with_friction(tmp_path) if name == "friction" else name
    table = planned(machine, "original" if name == "lab" else None, tmp_path)
    base = cmf_mj.load_machine(machine)
    leg = load_motion_limits(None, base).leg
    folder, most = tmp_path / "campaign", []
    for one, said in table["recordings"].items():
        run = load_scenario(folder / said["source"])
        poses = demand(run)
        assert not poses[: run.rate].any()
        legs = pose_to_legs(poses, base)
        speed, acceleration = (np.diff(legs, n, axis=0) * float(run.rate) ** n for n in (1, 2))
        used = [np.abs(legs).max() / base.working_stroke]
        if said["kind"] != "step":
            used += [np.abs(speed).max() / leg.velocity.si]
            used += [np.abs(acceleration).max() / leg.acceleration.si]
        assert max(used) <= SHARE, one
        most.append(max(used))
        stream = read_stream(folder / "host" / f"{one}.csv")
        rows = np.round(stream.time * run.rate).astype(int)
        assert np.abs(stream.pose - poses[rows]).max() < 1e-9
    assert max(most) > 0.5 * SHARE
    held = [said["held_back"] for said in table["recordings"].values()]
    assert sum(held) == 2
    assert {said["kind"] for said in table["recordings"].values()} == {
        *("hold", "ramp", "multisine", "step")
    }


def test_record_tells_what_was_recorded_and_no_number_of_the_machine(tmp_path: Path) -> None:
    """Recordings of a hidden machine, of other valves by another seed, after the folder moved.

    Data sheet and folder go elsewhere; the law is not there any more, and a copy is used.
    """
    law, there = tmp_path / "mine.toml", tmp_path / "there"
    table = cmf_mj.load_law("original").model_dump(
        mode="json", exclude={"name"}, exclude_defaults=True
    )
    law.write_text(tomlkit.dumps({"mine": table}), encoding="utf-8")
    there.mkdir()
    sheet = machine_with_friction(there)
    how: dict[str, Any] = {"seconds": 10.0, "share": SHARE, "other_law": law}
    path = plan_campaign(sheet, None, None, law, there / "campaign", **how)
    law.unlink()
    path = there.rename(tmp_path / "here") / path.relative_to(there)
    table = read_toml(path)
    table["recordings"] = {name: table["recordings"][name] for name in ("hold", "other_law")}
    path.write_text(tomlkit.dumps(table), encoding="utf-8")
    hidden = cmf_mj.load_cab(None, "lab").changed("hidden", mass=345.678)
    records = []
    for seed in (1, 2):
        record_campaign(path.parent, machine="lab", cab=hidden, seed=seed, jobs=1)
        records.append(load_campaign(path.parent).recordings[0].record)
    record = records[0]
    assert set(record.metadata) == {
        *("sample_rate", "law", "command", "machine", "machine_parameters")
    }
    assert record.metadata["law"] == "mine"
    assert recorded_machine(record.metadata) == cmf_mj.load_machine(path.parents[1] / sheet.name)
    assert "345.678" not in json.dumps(dict(record.metadata), default=str)
    assert not {"leg_extension", "leg_force", "platform_pose"} & set(record.channels)
    assert record["leg_position"][:64].std() > 0.0
    moving = np.abs(records[0]["valve_command"] - records[1]["valve_command"]).max()
    assert moving > 0.005
    assert (record["leg_reference"] == records[1]["leg_reference"]).all()


def test_refusals_name_field_and_value(tmp_path: Path) -> None:
    """A folder in use, a length and a share out of range, a plan that is not there."""
    folder = tmp_path / "campaign"
    with pytest.raises(cmf_mj.InputError, match=r"seconds: 1 is refused; allowed: 10 to 600"):
        plan_campaign("lab", None, None, None, folder, seconds=1.0)
    with pytest.raises(cmf_mj.InputError, match=r"share: 2 is refused"):
        plan_campaign("lab", None, None, None, folder, share=2.0)
    assert not folder.exists()
    with pytest.raises(cmf_mj.InputError, match=r"campaign\.toml"):
        record_campaign(folder)
    folder.mkdir()
    (folder / "campaign.toml").write_text("", encoding="utf-8")
    with pytest.raises(cmf_mj.InputError, match="holds a campaign"):
        plan_campaign("lab", None, None, None, folder)
