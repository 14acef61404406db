"""A user's cab on the hexapod: closed forms of what the legs feel."""

import numpy as np
import pytest
from numpy.typing import NDArray

from cmf_mj.machine import models
from cmf_mj.machine.cab import Cab, load_cab, recorded_cab
from cmf_mj.plant.hexapod import Hexapod, hexapod_model, hexapod_spec
from cmf_mj.plant.native import saved_model

LIGHT = 1e-6  #: Factor on the legs' masses that leaves none to speak of.


def box(sizes: tuple[float, float, float], mass: float) -> NDArray[np.float64]:
    square = np.array(sizes) ** 2
    return np.diag(mass * (square.sum() - square) / 12.0)


def compact(mass: float, size: float = 0.02) -> Cab:
    """Nearly a point mass in the platform's centroid, on legs of nearly no mass."""
    inertia, part = box((size,) * 3, 0.5 * mass), {"mass": 0.5 * mass}
    body = {**part, "centre_of_mass": np.zeros(3), "inertia": inertia}
    return load_cab().changed("compact", platform=body, leg_mass_factor=LIGHT, **body)


def odd() -> Cab:
    """A cab whose every number is its own, products of inertia included."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    return load_cab("rfd").changed(
        "odd",
        mass=8000.0,
        centre_of_mass=(0.3, -0.2, 1.1),
        inertia=turn @ box((4.0, 3.0, 2.0), 8000.0) @ turn.T,
        platform={"mass": 5000.0, "centre_of_mass": (0.0, 0.0, 0.0)},
        leg_mass_factor=1.3,
    )


@pytest.mark.parametrize("name", models.CABS)
def test_a_shipped_cab_is_the_model_as_it_compiles(name: str) -> None:
    assert saved_model(hexapod_model(name)) == saved_model(hexapod_spec(name).compile())


@pytest.mark.parametrize("name", models.CABS)
def test_the_numbers_of_a_shipped_cab_are_those_of_its_model(name: str) -> None:
    model, cab = hexapod_spec(name).compile(), load_cab(name)
    for body, part in (("platform", cab.platform), ("cab/cab", cab)):
        assert model.body(body).mass[0] == part.mass.si
        assert np.array_equal(model.body(body).ipos, part.centre_of_mass.si)
        assert np.array_equal(model.body(body).inertia, part.inertia.si)
    for leg in range(1, 7):
        assert model.body(f"cylinder_{leg}").mass[0] == cab.legs.cylinder_mass.si
        assert model.body(f"rod_{leg}").mass[0] == cab.legs.rod_mass.si


@pytest.mark.parametrize("name", models.CABS)
def test_the_numbers_of_a_shipped_cab_stated_again_are_the_same_machine(name: str) -> None:
    cab = load_cab(name)
    again = cab.changed(
        "again",
        mass=cab.mass.si,
        centre_of_mass=cab.centre_of_mass.si,
        inertia=cab.tensor,
        platform={"mass": cab.platform.mass.si, "inertia": cab.platform.tensor},
        leg_mass_factor=1.0,
    )
    assert again != cab
    assert saved_model(hexapod_model(again)) == saved_model(hexapod_model(name))


@pytest.mark.parametrize("cab", [odd(), load_cab().changed("heavy", mass=12e3), compact(9e3)])
def test_editing_the_compiled_model_is_compiling_the_edited_one(cab: Cab) -> None:
    """All but `meansize`, by which MuJoCo scales what it draws."""
    model, compiled = hexapod_model(cab), hexapod_spec(cab).compile()
    model.stat.meansize = compiled.stat.meansize
    assert saved_model(model) == saved_model(compiled)
    assert saved_model(model) != saved_model(hexapod_model(cab.base))


def test_a_model_that_was_edited_leaves_the_next_one_alone() -> None:
    before = saved_model(hexapod_model("gfd"))
    hexapod_model("gfd").body_mass[:] = 1.0
    Hexapod(compact(9e3))
    assert saved_model(hexapod_model("gfd")) == before


def test_the_plant_says_which_cab_it_carries() -> None:
    plant = Hexapod(odd())
    assert (plant.cab, plant.cab_parameters) == ("odd", odd())
    about = plant.describe()
    assert about["cab"] == "odd"
    assert recorded_cab(about) == odd()
    assert plant.digest != Hexapod("rfd").digest


def test_a_cab_beyond_what_the_supply_can_hold_is_refused() -> None:
    heavy = load_cab().changed("heavy", mass=90e3)
    with pytest.raises(ValueError, match="static load of leg 1: .* cannot be held by a supply of"):
        Hexapod(heavy).start()
