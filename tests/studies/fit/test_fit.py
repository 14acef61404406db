"""A machine is found from its recordings, and what they cannot tell is said."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomlkit
from scipy import stats
from shared import cmf

import cmf_mj
from cmf_mj.core.errors import InputError
from cmf_mj.core.settings import read_toml
from cmf_mj.electronics.chain import ElectronicsSettings
from cmf_mj.electronics.sensors import load_sensors
from cmf_mj.facility.unknown import Unknown
from cmf_mj.facility.unknowns import Unknowns
from cmf_mj.studies.certificate_box import load_box
from cmf_mj.studies.fit import doubt, results
from cmf_mj.studies.fit.campaign import FILE, default_unknowns, load_campaign
from cmf_mj.studies.fit.engine import Posterior, fit
from cmf_mj.studies.fit.iteration import Fitter

SECONDS, RATE = 5.0, 128

KNOWN = {
    "leg_speed": {"path": "hydraulics.leg_speed", "deviation": 20.0},
    "mass": {"path": "cab.mass", "deviation": 30.0},
    "drive_lag": {"path": "hydraulics.drive_lag", "low": 0.5, "high": 2.0, "unit": "1"},
    "valve_lag": {"path": "hydraulics.valve_lag", "low": 0.5, "high": 2.0, "unit": "1"},
}
TRUTH = {"leg_speed": 1.1, "mass": 0.85, "drive_lag": 1.2, "valve_lag": 0.8}


def motion(dof: int, seed: int) -> np.ndarray:
    """Poses (N, 6) of a sum of sines about neutral [m, rad], faded in and out."""
    machine = cmf_mj.load_machine("lab")
    time = np.arange(int(SECONDS * machine.rate)) / machine.rate
    generator = np.random.default_rng(seed)
    sines = [
        np.sin(2.0 * np.pi * f * time + generator.uniform(0.0, 6.0)) / (1.0 + f**2)
        for f in np.arange(0.4, 20.0, 0.4)
    ]
    fade = np.clip(time, 0.0, 1.0) ** 2 * np.clip(SECONDS - time, 0.0, 1.0) ** 2
    poses = np.zeros((time.size, 6))
    poses[:, dof] = 0.02 * (3.0 if dof > 2 else 1.0) * fade * np.sum(sines, axis=0)
    return poses


def campaign(folder: Path, plant: cmf_mj.Plant, electronics: Any = "noisy") -> Path:
    """Record a plant in three motions, the last one held back."""
    folder.mkdir()
    recordings = {}
    for number, dof in enumerate((0, 2, 4)):
        record = cmf_mj.simulate(
            plant, "original", motion(dof, number), electronics=electronics, record_every=16
        )
        keep = ("leg_reference", "leg_position", "cap_pressure", "rod_pressure")
        cmf_mj.Record(
            record.time,
            {name: record[name] for name in keep},
            {name: record.units[name] for name in keep},
            {"sample_rate": record.rate},
        ).save(folder / f"{dof}.parquet")
        said = {"file": f"{dof}.parquet", "kind": "multisine", "held_back": number == 2}
        recordings[f"axis_{dof}"] = said
    unknowns = {name: one | {"source": "test"} for name, one in KNOWN.items()}
    table = {"machine": "lab", "law": "original", "recordings": recordings, "unknowns": unknowns}
    (folder / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    return folder


def hidden(**changes: float) -> cmf_mj.Hexapod:
    plant = cmf_mj.Hexapod(machine="lab")
    known = {name: one | {"source": "test"} for name, one in KNOWN.items()}
    made = Unknowns({name: Unknown(**one) for name, one in known.items()})  # type: ignore[arg-type]
    oil = made.apply(TRUTH, plant.parameters, "hidden")
    overlap = oil.overlap.model_copy(update={"value": changes.get("overlap", 0.0)})
    cab = made.apply(TRUTH, cmf_mj.load_cab(None, "lab"), "hidden")
    return cmf_mj.Hexapod(cab, oil.model_copy(update={"overlap": overlap}))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Posterior, Path]:
    """The fit of a hidden machine, and its folder."""
    folder = tmp_path_factory.mktemp("fit")
    made = campaign(folder / "campaign", hidden())
    return fit(made, folder / "out"), folder


def test_the_machine_is_found_and_twins_are_said(found: tuple[Posterior, Path]) -> None:
    """Mass and speed within 1 %; lags, which can be exchanged, in intervals that say so."""
    posterior, _ = found
    truth = dict(zip(results.paths(posterior), TRUTH.values(), strict=True))
    rows = {row[0]: row for row in results.numbers(posterior).rows}
    limits = results.physical(posterior, posterior.bounds(0.99)).T
    for (path, factor), (low, high) in zip(truth.items(), limits, strict=True):
        real = factor * posterior.campaign.nominal(path)[0]
        _, value, *_, known = rows[path]
        assert low <= real <= high, path
        if not path.endswith("_lag"):
            assert known == "yes"
            assert value == pytest.approx(real, rel=0.01)
    assert posterior.twins == (("drive_lag", "valve_lag"),)
    low, high = posterior.bounds()
    assert np.all((low < posterior.exchanged_z) & (posterior.exchanged_z < high))
    assert abs(posterior.exchanged_z - posterior.z).max() > 0.1
    least, most = posterior.bounds(exchange=False)
    assert np.all((low <= least) & (least < posterior.z) & (posterior.z < most) & (most <= high))
    assert np.array_equal(most - least < high - low, [p.endswith("_lag") for p in truth])


def test_a_held_back_recording_is_predicted(found: tuple[Posterior, Path]) -> None:
    doubts = doubt.doubt(found[0])
    assert [one.recording for one in doubts.predictions] == ["axis_4"]
    assert doubts.predictions[0].is_close
    assert doubts.is_explained, doubts.verdict
    assert "cannot be separated" in doubts.verdict


def test_the_fitted_machine_is_a_file_that_commands_take(found: tuple[Posterior, Path]) -> None:
    """The same plant as that of the fit, its numbers identified, and a box for `certify`."""
    posterior, folder = found
    path = results.save(posterior, folder / "out")
    machine = cmf_mj.load_machine(path)
    plant = cmf_mj.Hexapod(cmf_mj.load_cab(None, machine))
    own = posterior.applied(posterior.campaign.plant)
    assert plant.model.body_mass == pytest.approx(own.model.body_mass)
    assert plant.model.body_inertia == pytest.approx(own.model.body_inertia)
    speed = plant.parameters.leg_speed
    assert speed.si == pytest.approx(own.parameters.leg_speed.si)
    assert (speed.status, plant.cab_parameters.mass.status) == ("identified", "identified")
    assert load_box(folder / "out" / "box.toml").unknowns["cab_mass"].half < 0.05


def test_steps_are_taken_from_the_journal(found: tuple[Posterior, Path]) -> None:
    posterior, folder = found
    said: list[str] = []
    again = fit(folder / "campaign", folder / "out", jobs=1, announce=said.append)
    assert said[:2] == [
        "weighing at rest",
        "slow 1: 5 machines, 2 recordings each, compiling first if new",
    ]
    assert np.array_equal(again.z, posterior.z)
    assert np.array_equal(again.covariance, posterior.covariance)


def test_a_number_with_no_room_is_named(
    found: tuple[Posterior, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a machine that leaves its bounds however its mass changes."""
    fitter, x = Fitter(found[0].campaign, "slow", jobs=1), found[0].z
    here = found[0].linearised.residuals
    monkeypatch.setattr(fitter, "residuals", lambda at: here if at[1] == x[1] else None)
    with pytest.raises(InputError, match="^mass: the machine leaves its bounds"):
        fitter.derivatives(x, here, np.full(x.size, 0.01))


def test_a_fit_says_what_it_does_before_it_reads(tmp_path: Path) -> None:
    """On the error stream, where a bar is; a fit that is refused has said that it reads."""
    said: list[str] = []

    @contextmanager
    def bar(*_: str, seconds: bool) -> Iterator[Callable[..., None]]:
        yield lambda done, total, now: said.append(now)

    (tmp_path / FILE).write_text("machine = 3")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cmf_mj.cli.campaign.progress_bar", bar)
        refused = cmf("fit", tmp_path, "--out", tmp_path / "out", code=2)
    assert "machine" in refused
    assert said == ["reading recordings"]


def test_effects_that_help_widen_the_numbers(found: tuple[Posterior, Path]) -> None:
    """A number may be where it is with the effect or without: of the one that helps, not more."""
    posterior, shift = found[0], np.array([0.0, 0.25, 0.0, -0.25])
    effects = doubt.Effect("floor", 11.0, shift), doubt.Effect("gas", 9.0, 4.0 * shift)
    wide = doubt.Doubt((), (), (), (), effects, ()).widened(posterior)
    further = wide.bounds() - posterior.bounds()
    np.testing.assert_allclose(
        further, [np.minimum(shift, 0.0), np.maximum(shift, 0.0)], atol=1e-12
    )
    moved = wide.samples(4000) - posterior.samples(4000)
    np.testing.assert_allclose(moved.mean(axis=0), 0.5 * shift, atol=0.02)


def test_samples_are_as_wide_as_the_bounds() -> None:
    """Student's t of 3 degrees: quantiles of 40000 samples against z + scale t^-1(q)."""
    z, scale, none = np.array([0.2, -0.1]), np.array([0.1, 0.03]), np.empty(0)
    about: Any = None  # neither campaign nor linearisation count
    posterior = Posterior(about, ("a", "b"), z, np.diag(scale**2), 3.0, about, (), z, none, none)
    drawn = posterior.samples(40000)
    for share in (0.5, 0.9):
        ends = np.quantile(drawn, [0.5 - 0.5 * share, 0.5 + 0.5 * share], axis=0)
        exact = z + np.outer([-1.0, 1.0], scale) * stats.t.ppf(0.5 + 0.5 * share, 3.0)
        np.testing.assert_allclose(posterior.bounds(share), exact, rtol=1e-9)
        np.testing.assert_allclose((ends - exact) / scale, 0.0, atol=0.08)


def test_the_lag_and_the_gain_of_sensors_are_found(tmp_path: Path) -> None:
    """Positions behind a corner of 40 Hz, 4 ms, not 500 Hz; one that reads 1 % too much."""
    place = {"path": "electronics.leg_position.bandwidth", "low": 0.04, "high": 1.0, "unit": "1"}
    gain = {"path": "electronics.leg_position.gain_errors.2", "effect": "offset", "deviation": 3.0}
    known = {"lag": place | {"distribution": "loguniform"}, "gain": gain}
    known = {name: one | {"source": "test"} for name, one in known.items()}
    unknowns = Unknowns({name: Unknown(**one) for name, one in known.items()})  # type: ignore[arg-type]
    truth = {"lag": 0.08, "gain": 0.01}
    sensors = unknowns.apply(truth, ElectronicsSettings().of(cmf_mj.load_machine("lab")).sensors)
    made = campaign(tmp_path / "made", cmf_mj.Hexapod(machine="lab"), {"sensors": sensors})
    table = read_toml(made / FILE) | {"unknowns": known}
    (made / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    posterior = fit(made, tmp_path / "out")
    corner, error = results.physical(posterior, posterior.z)
    assert corner / (2.0 * np.pi) == pytest.approx(40.0, rel=0.02)
    assert error == pytest.approx(0.01, abs=2e-4)
    low, high = results.physical(posterior, posterior.bounds(0.99))
    assert np.all((low < [80.0 * np.pi, 0.01]) & (high > [80.0 * np.pi, 0.01]))
    results.save(posterior, tmp_path / "out")
    read = load_sensors(tmp_path / "out" / "sensors.toml").leg_position
    assert read.bandwidth.si == pytest.approx(corner)
    assert read.bandwidth.status == "identified"
    assert [one.value for one in read.gain_errors] == pytest.approx([0, error, 0, 0, 0, 0])
    (made / FILE).write_text(tomlkit.dumps(table | {"electronics": "ideal"}), encoding="utf-8")
    with pytest.raises(InputError, match=r"unknowns\.lag: .*electronics are ideal"):
        load_campaign(made)


@pytest.mark.slow
def test_overlap_that_the_model_lacks_is_named(tmp_path: Path) -> None:
    """2 % of the spool's travel would help most; with it leg speed and mass are nearer."""
    made = campaign(tmp_path / "campaign", hidden(overlap=0.02))
    posterior = fit(made, tmp_path / "out", jobs=2)
    doubts = doubt.doubt(posterior)
    assert not doubts.is_explained
    effect = doubts.effects[0]
    assert effect.name == "valve overlap"
    assert effect.helps
    paths = results.paths(posterior)[:2]
    truth = np.array([1.1, 0.85]) * [posterior.campaign.nominal(path)[0] for path in paths]
    numbers = results.physical(posterior, posterior.z + np.outer([0.0, 1.0], effect.shift))
    wrong, right = np.abs(numbers[:, :2] / truth - 1.0).max(axis=1)
    assert right < 0.5 * wrong < 0.005, (right, wrong)


def test_offset_of_two_clocks_is_found_in_what_was_held_back() -> None:
    """White noise 7 ms apart; with it taken out no phase is left."""
    rate, late, lines = 256.0, 0.007, np.fft.rfftfreq(5120, 1.0 / 256.0)
    simulated = np.random.default_rng(1).normal(size=(5120, 2))
    turned = np.fft.rfft(simulated, axis=0) * np.exp(2j * np.pi * lines * late)[:, None]
    measured = np.fft.irfft(turned, 5120, axis=0)
    found = doubt._clock_offset(*doubt._ratios(measured, simulated, rate))
    assert found == pytest.approx(late, abs=3e-4)


def test_what_is_wrong_with_a_campaign_is_named(tmp_path: Path) -> None:
    said = {"file": "a.parquet", "kind": "hold", "held_back": True}
    table = {"machine": "lab", "recordings": {"a": said}}
    (tmp_path / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    with pytest.raises(InputError, match=r"recordings\.a: .*a\.parquet"):
        load_campaign(tmp_path)
    time = np.arange(256) / RATE
    legs = np.zeros((256, 6))
    channels = {"leg_reference": legs, "leg_position": legs}
    units, about = dict.fromkeys(channels, "m"), {"sample_rate": float(RATE)}
    cmf_mj.Record(time, channels, units, about).save(tmp_path / "a.parquet")
    with pytest.raises(InputError, match="has nothing to fit"):
        load_campaign(tmp_path)
    said["held_back"] = False
    (tmp_path / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    far = {"leg_reference": legs, "leg_position": np.where(time[:, None] == 0.5, np.inf, legs)}
    cmf_mj.Record(time, far, units, about).save(tmp_path / "a.parquet")
    with pytest.raises(InputError, match=r"leg_position: has none at 0\.5 s"):
        load_campaign(tmp_path)
    cmf_mj.Record(time, channels, units, about).save(tmp_path / "a.parquet")
    said["kind"] = "valves"
    (tmp_path / FILE).write_text(tomlkit.dumps(table), encoding="utf-8")
    with pytest.raises(InputError, match="valve_command: is missing"):
        load_campaign(tmp_path)


@pytest.mark.parametrize("name", ["cmf", "simona", "lab"])
def test_any_data_sheet_has_unknowns_that_change_the_plant(name: str) -> None:
    """At 0.1 quantiles off the middle every number differs, at the middle mass and speed do not."""
    plant = cmf_mj.Hexapod(machine=name)
    known = default_unknowns(plant.cab_parameters, plant.parameters).on(plant)
    size = len(known.numbers())
    middle, off = (known.apply(known.at(np.full(size, at)), plant) for at in (0.5, 0.6))
    assert middle.cab_parameters.payload.mass == pytest.approx(plant.cab_parameters.payload.mass)
    assert off.cab_parameters.payload.mass > middle.cab_parameters.payload.mass
    assert off.parameters.coulomb_friction.si > middle.parameters.coulomb_friction.si
