"""Effects that recordings have and the model lacks are named by what they gain."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import cmf_mj
from cmf_mj.plant.plant import Plant
from cmf_mj.plant.yielding import Floor, on_floor, on_mounts
from cmf_mj.studies.fit import effects
from cmf_mj.studies.fit.campaign import load_campaign
from cmf_mj.studies.fit.effects import EFFECTS, Effect, try_effects
from cmf_mj.studies.fit.iteration import Fitter
from tests.studies.fit.test_fit import campaign

TRIED = ("valve overlap", "a floor that yields", "legs that yield")


def gains(folder: Path, machine: Plant) -> list[Effect]:
    """What effects gain on recordings of a machine whose numbers are those of the data sheet."""
    fitter = Fitter(load_campaign(campaign(folder / "campaign", machine)), "whole", jobs=2)
    there = np.array([0.0, 0.0, *stats.norm.ppf([1.0 / 3.0] * 2)])  # factors 1, of lags in 0.5 to 2
    return try_effects(fitter.linearised_at(there, np.full(there.size, 0.03)), fitter)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "on"),
    [
        ("a floor that yields", lambda plant: on_floor(plant, Floor(2500.0, 3e7))),
        ("legs that yield", lambda plant: on_mounts(plant, 4e7)),
        ("", lambda plant: plant),
    ],
)
def test_what_yields_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, on: Callable[[Plant], Plant]
) -> None:
    """By recordings of our own plant with it; of one without it none is said to help."""
    monkeypatch.setattr(effects, "EFFECTS", {key: EFFECTS[key] for key in TRIED})
    found = gains(tmp_path, on(cmf_mj.Hexapod(machine="lab")))
    helping = [one.name for one in found if one.helps]
    assert helping[:1] == ([name] if name else []), found


def test_the_number_of_a_spring_is_its_compliance() -> None:
    """One size of legs that yield is a fourth of the compliance of the oil in them."""
    plant = cmf_mj.Hexapod(machine="lab")
    (change,) = EFFECTS["legs that yield"].changes(plant, ("",))
    once, twice = (change(plant, np.array([size])).model.eq_solref[0] for size in (1.0, 2.0))
    np.testing.assert_allclose(once, 2.0 * twice)
    oil = 6541476.69587172  # N/m, beta A (1 / h + ratio / h) of the data sheet
    np.testing.assert_allclose(once, on_mounts(plant, 4.0 * oil).model.eq_solref[0], rtol=1e-9)


def test_floors_are_tried_at_the_frequencies_they_swing_at() -> None:
    """Of half a size ten times as heavy as the machine, on springs that bear both."""
    plant = cmf_mj.Hexapod(machine="lab")
    mass = float(plant.model.body_mass.sum())
    for change, hertz in zip(
        EFFECTS["a floor that yields"].changes(plant, ("",)),
        np.geomspace(8.0, 32.0, 7),
        strict=True,
    ):
        model = change(plant, np.array([0.5])).model
        assert model.body("floor").mass[0] == pytest.approx(10.0 * mass)
        rate = np.sqrt(model.joint("floor_x").stiffness[0] / (11.0 * mass))
        assert rate == pytest.approx(2.0 * np.pi * hertz)
