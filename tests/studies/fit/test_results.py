"""The files of a fit against the plant it found: what each path fills, its unit and source."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from scipy.interpolate import CubicSpline

import cmf_mj
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import read_toml
from cmf_mj.facility.run import Run
from cmf_mj.studies.certificate_box import load_box
from cmf_mj.studies.fit import results
from cmf_mj.studies.fit.campaign import FILE, load_campaign
from cmf_mj.studies.fit.engine import Posterior
from cmf_mj.studies.fit.model import Model
from cmf_mj.studies.tuning.search import save_law

FACTOR = {"low": 0.9, "high": 1.3, "unit": "1"}
AT = 1.1  #: The factor in the middle.


def posterior(folder: Path, unknowns: dict[str, dict[str, Any]], **more: Any) -> Posterior:
    """What a fit to a table leaves that finds the middle of all ranges."""
    known = {name: {"source": "test", **one} for name, one in unknowns.items()}
    stated = {"mine": {"source": "Table 9", "damping_ratio": 0.4}}
    table = {"machine": "lab", "unknowns": known, "evidence": stated} | more
    (folder / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    campaign = load_campaign(folder)
    names = tuple(name for name, *_ in campaign.unknowns.numbers())
    z, none = np.zeros(len(names)), np.empty((0, len(names)))
    spread = 0.01 * np.eye(len(names))
    return Posterior(campaign, names, z, spread, 9.0, None, (), z, none, np.empty(0))  # type: ignore[arg-type]


def row(found: Posterior) -> tuple[float, str]:
    """The value of the first number and its unit."""
    _, value, *_, unit, _ = results.numbers(found).rows[0]
    return value, unit


@pytest.mark.parametrize(
    ("path", "fields"),
    [
        ("hydraulics.supply", ["supply_pressure", "relief_pressure", "proof_pressure"]),
        ("hydraulics.friction", ["coulomb_friction", "breakaway_friction"]),
        ("hydraulics.stiction", ["breakaway_friction"]),
        ("hydraulics.actuators.leg_2.valve_gain", ["actuators.leg_2.leg_speed"]),
        ("hydraulics.actuators.leg_2.leakage", ["actuators.leg_2.leak_rate"]),
        ("legs.mass", ["legs.cylinder_mass", "legs.rod_mass"]),
        ("cab.density", ["cab.mass", "cab.inertia"]),
        ("payload.density", ["cab.mass", "cab.inertia", "platform.mass", "platform.inertia"]),
    ],
)
def test_exactly_what_a_path_changes_is_identified(
    tmp_path: Path, path: str, fields: list[str]
) -> None:
    results.save(posterior(tmp_path, {"x": {"path": path, **FACTOR}}), tmp_path)
    table = read_toml(tmp_path / "machine.toml")
    flat = {
        "cab": table["cabs"]["fitted"],
        "platform": table["platform"],
        "legs": table["legs"],
        **table["hydraulics"],
    }
    named = {}
    for name, entry in flat.items():
        named[name] = entry
        for inner, value in entry.items() if isinstance(entry, dict) else ():
            named[f"{name}.{inner}"] = value
            for last, deepest in value.items() if name == "actuators" else ():
                named[f"{name}.{inner}.{last}"] = deepest
    marked = {
        name: entry["source"]
        for name, entry in named.items()
        if isinstance(entry, dict) and entry.get("status") == "identified"
    }
    assert set(fields) <= marked.keys()
    assert len(marked) == len(fields) + path.endswith(".supply")  # and the precharge
    assert set(marked.values()) == {"fitted to what is stated in Table 9"}


def test_the_law_file_holds_the_fitted_law_from_any_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A law beside the campaign, its pole changed: by a factor, and by an offset with a unit."""
    mine = save_law(cmf_mj.load_law("velocity"), tmp_path / "mine.toml")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    pole = cmf_mj.load_law(mine).derivative_pole
    path = {"path": "law.derivative_pole"}
    offset = {"effect": "offset", "low": -5.0, "high": 15.0, "unit": "rad/s"}
    for change, due in ((FACTOR, AT * pole), (offset, pole + 5.0)):
        found = posterior(tmp_path, {"pole": path | change}, law="mine.toml")
        results.save(found, tmp_path / "out")
        law = cmf_mj.load_law(tmp_path / "out" / "law.toml")
        assert law.derivative_pole == pytest.approx(due)
        assert row(found) == (pytest.approx(due), "rad/s")


def test_each_number_has_its_own_unit(tmp_path: Path) -> None:
    """Of the file's number in SI; 1 where it is a factor; a valve's own bias, not the set's."""
    oil = cmf_mj.Hexapod(machine="lab").parameters
    for path, due in (
        ("hydraulics.bore_diameter", (AT * oil.bore_diameter.si, "m")),
        ("hydraulics.drive_lag", (AT * oil.drive_lag.si, "rad/s")),
        ("hydraulics.leg_speed", (AT * oil.leg_speed.si, "m/s")),
        ("hydraulics.viscous_friction", (AT * oil.viscous_friction.si, "N s/m")),
        ("legs.mass", (AT, "1")),
        ("electronics.leg_position.bandwidth", None),
    ):
        found = posterior(tmp_path, {"x": {"path": path, **FACTOR}}, electronics="noisy")
        assert row(found) == (pytest.approx(due[0]), due[1]) if due else row(found)[1] == "rad/s"
    (tmp_path / "oil.toml").write_text(
        'base = "hardware"\n[mine.actuators.leg_1.valve_1]\n'
        'null_bias = { value = 0.03, unit = "1", status = "stated", source = "test" }\n',
        encoding="utf-8",
    )
    bias = {"path": "hydraulics.actuators.leg_1.valve_1.null_bias", "effect": "offset"}
    more = {"machine": "cmf", "hydraulics": "oil.toml"}
    found = posterior(tmp_path, {"x": bias | {"deviation": 1.0}}, **more)
    assert row(found) == (pytest.approx(0.03), "1")


def test_a_box_takes_each_number_by_its_whole_path(tmp_path: Path) -> None:
    """Mass of legs and platform is not that of the cab; the pressure of the supply is written."""
    standing = load_box().unknowns
    for path, name in (
        ("legs.mass", None),
        ("platform.mass", None),
        ("hydraulics.supply", "supply_pressure"),
        ("hydraulics.actuators.*.valve_gain", "valve_gain"),
        ("hydraulics.actuators.*.leakage", "leak_rate"),
        ("cab.inertia", "cab_inertia"),
    ):
        found = results.box(posterior(tmp_path, {"x": {"path": path, **FACTOR}}))["unknowns"]
        changed = {key for key, one in standing.items() if found[key]["source"] != one.source}
        assert changed == ({name} if name else set()), path


@pytest.mark.parametrize("path", ["machine.floor", "effect.lap", "model.body.platform.mass"])
def test_numbers_that_no_fit_applies_are_refused(tmp_path: Path, path: str) -> None:
    with pytest.raises(InputError, match=f"x: '{path}' is refused; allowed: hydraulics"):
        posterior(tmp_path, {"x": {"path": path, **FACTOR}})


def test_a_number_of_the_law_changes_the_law_of_every_recording(tmp_path: Path) -> None:
    """Simulated with its pole, as by the changed law; of valve commands there is none."""
    law, plant = cmf_mj.load_law("original"), cmf_mj.Hexapod(machine="lab")
    pole = {"pole": {"path": "law.derivative_pole", **FACTOR}}
    command = cmf_mj.signals.sine("heave", 0.01, 4.0, cycles=6.0)
    cmf_mj.simulate(plant, law, command, record_every=16).save(tmp_path / "sine.parquet")
    said = {kind: {"file": "sine.parquet", "kind": kind} for kind in ("sweep", "valves")}
    found = posterior(tmp_path, pole, law="original", recordings=said, electronics="ideal")
    model = Model(found.campaign)
    other = law.model_copy(update={"derivative_pole": AT * law.derivative_pole})
    closed, driven = (
        model.simulate(one, found.z, model.plant)["leg_position"] for one in model.pieces
    )
    piece = model.pieces[0]
    due = Run(plant=plant, law=other, **piece.run_settings).record()
    expected = CubicSpline(due.time, due["leg_position"])(piece.time)
    np.testing.assert_array_equal(closed, expected)
    assert np.abs(closed - piece.measured["leg_position"]).max() > 1e-6
    assert np.isfinite(driven).all()
