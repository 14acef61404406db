"""What planned recordings are worth, against what the same recording again must be."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit

import cmf_mj
from cmf_mj.core.errors import InputError
from cmf_mj.facility.scenario import load_scenario
from cmf_mj.studies.fit.campaign import FILE, load_campaign
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.iteration import Fitter
from cmf_mj.studies.fit.worth import worth

UNKNOWNS = {
    "leg_speed": {"path": "hydraulics.leg_speed", "deviation": 20.0, "source": "test"},
    "mass": {"path": "cab.mass", "deviation": 30.0, "source": "test"},
}
SCENARIO = """machine = "lab"
electronics = "noisy"
record_every = 16
duration = 8.0
[[signal]]
kind = "multisine"
dof = "heave"
amplitude = 0.02
stop = 10.0
period = 4.0
periods = 2
"""


def written(folder: Path, recordings: dict[str, Any], **more: Any) -> Path:
    """A folder's campaign; in it a scenario, beside that its recording with positions alone."""
    folder.mkdir()
    table = {"machine": "lab", "unknowns": UNKNOWNS, "recordings": recordings} | more
    (folder / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    (folder / "heave.toml").write_text(SCENARIO, encoding="utf-8")
    record = load_scenario(folder / "heave.toml").record()
    kept = {name: record[name] for name in ("leg_reference", "leg_position")}
    units = dict.fromkeys(kept, "m")
    for name, every in (("heave", 1), ("slow", 4)):
        rows = {channel: values[::every] for channel, values in kept.items()}
        about = {"sample_rate": record.rate / every}
        one = cmf_mj.Record(record.time[::every], rows, units, about)
        one.save(folder / f"{name}.parquet")
    return folder


def fitted(folder: Path) -> Posterior:
    """What a fit leaves that ends where it begins: the data sheet's machine was recorded."""
    campaign = load_campaign(folder)
    names = tuple(name for name, *_ in campaign.unknowns.numbers())
    z, none = np.zeros(len(names)), np.empty((0, len(names)))
    end = Fitter(campaign, "whole", 1).linearised_at(z, np.full(z.size, 0.01))
    spread = np.linalg.inv(end.hessian)
    return Posterior(campaign, names, z, spread, 9.0, end, (), z, none, np.empty(0))


def said(kind: str, **more: Any) -> dict[str, Any]:
    return {"file": "heave.parquet", "kind": kind, "source": "heave.toml"} | more


def test_the_same_recording_again_takes_a_root_of_two(tmp_path: Path) -> None:
    """Without pressures, beside one of another rate; valves are commanded without a law.

    H >> 1, so that H + H_c is 2 H: the deviation falls to 1 / sqrt(2), of every number.
    """
    slow = said("multisine", file="slow.parquet", held_back=True)
    found = fitted(written(tmp_path / "made", {"slow": slow, "fast": said("multisine")}))
    plan = written(tmp_path / "plan", {"again": said("multisine"), "driven": said("valves")})
    rows = {one.recording: one for one in worth(found, plan, "leg_speed", 1)}
    assert rows["again"][1:] == pytest.approx((np.sqrt(0.5),) * 2, rel=0.02)
    assert 0.0 < rows["driven"].sought < 1.0
    assert 0.0 < worth(found, plan, "damping", 1)[0].sought < 1.0


def test_what_is_stated_alone_leaves_no_noise(tmp_path: Path) -> None:
    stated = {"mine": {"source": "a", "damping_ratio": 0.4}}
    held = {"a": said("sweep", held_back=True)}
    found = fitted(written(tmp_path / "made", held, evidence=stated))
    with pytest.raises(InputError, match="campaign: has no recordings that are fitted"):
        worth(found, tmp_path / "made", "leg_speed", 1)
