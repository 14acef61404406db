"""A user's cab on the hexapod: closed forms of what the legs feel."""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from cmf_mj.core import units
from cmf_mj.machine import models
from cmf_mj.machine.cab import Cab, load_cab, recorded_cab
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.plant.cylinder import stiffness
from cmf_mj.plant.hexapod import Hexapod, hexapod_model, hexapod_spec

LIGHT = 1e-6
"""Factor on the legs' masses that leaves none to speak of."""


def bytes_of(model: mujoco.MjModel) -> bytes:
    buffer = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return buffer.tobytes()


def box(sizes: tuple[float, float, float], mass: float) -> NDArray[np.float64]:
    square = np.array(sizes) ** 2
    return np.diag(mass * (square.sum() - square) / 12.0)


def compact(mass: float, size: float = 0.02) -> Cab:
    """Nearly a point mass in the platform's centroid, on legs of nearly no mass."""
    inertia, part = box((size,) * 3, 0.5 * mass), {"mass": 0.5 * mass}
    body = {**part, "centre_of_mass": np.zeros(3), "inertia": inertia}
    return load_cab().changed("compact", platform=body, leg_mass=LIGHT, **body)


def odd() -> Cab:
    """A cab whose every number is its own, products of inertia included."""
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    return load_cab("rfd").changed(
        "odd",
        mass=8000.0,
        centre_of_mass=(0.3, -0.2, 1.1),
        inertia=turn @ box((4.0, 3.0, 2.0), 8000.0) @ turn.T,
        platform={"mass": 5000.0, "centre_of_mass": (0.0, 0.0, 0.0)},
        leg_mass=1.3,
    )


def at_centroid(cab: Cab) -> NDArray[np.float64]:
    """Mass matrix (6, 6) of platform and cab about the centroid, report axes (x, -y, -z)."""
    mass, centre, inertia = cab.payload
    x, y, z = centre * FLIP
    arm = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned = np.diag(FLIP) @ inertia @ np.diag(FLIP)
    return np.block([[mass * np.eye(3), -mass * arm], [mass * arm, turned - mass * arm @ arm]])


@pytest.mark.parametrize("name", models.CABS)
def test_a_shipped_cab_is_the_model_as_it_compiles(name: str) -> None:
    assert bytes_of(hexapod_model(name)) == bytes_of(hexapod_spec(name).compile())


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
        leg_mass=1.0,
    )
    assert again != cab
    assert bytes_of(hexapod_model(again)) == bytes_of(hexapod_model(name))


@pytest.mark.parametrize("cab", [odd(), load_cab().changed("heavy", mass=12e3), compact(9e3)])
def test_editing_the_compiled_model_is_compiling_the_edited_one(cab: Cab) -> None:
    """All but `meansize`, by which MuJoCo scales what it draws."""
    model, compiled = hexapod_model(cab), hexapod_spec(cab).compile()
    model.stat.meansize = compiled.stat.meansize
    assert bytes_of(model) == bytes_of(compiled)
    assert bytes_of(model) != bytes_of(hexapod_model(cab.base))


def test_a_model_that_was_edited_leaves_the_next_one_alone() -> None:
    before = bytes_of(hexapod_model("gfd"))
    hexapod_model("gfd").body_mass[:] = 1.0
    Hexapod(compact(9e3))
    assert bytes_of(hexapod_model("gfd")) == before


def test_reflected_mass_is_that_of_the_payload_through_the_jacobian() -> None:
    """M_leg = J^-T M J^-1 with legs of nearly no mass, products of inertia and all."""
    cab = odd().changed("odd", leg_mass=LIGHT)
    turn = np.linalg.inv(pose_jacobian(np.zeros(6)))
    expected = turn.T @ at_centroid(cab) @ turn
    found = Hexapod(cab).reflected_mass()
    assert found == pytest.approx(expected, abs=1e-5 * np.abs(expected).max())


def test_static_leg_loads_carry_the_weight() -> None:
    """Vertical parts of the six leg forces sum to the weight, their moments to its moment."""
    cab = odd().changed("odd", leg_mass=LIGHT)
    plant = Hexapod(cab)
    plant.start()
    forces = pose_jacobian(np.zeros(6)).T @ plant.static_load()
    mass, centre, _ = cab.payload
    weight = mass * units.STANDARD_GRAVITY
    x, y, _ = centre * FLIP
    # The legs push up, -z; gravity at (x, y) pulls down with the moments (y, -x) W.
    expected = [0.0, 0.0, -weight, -y * weight, x * weight, 0.0]
    assert forces == pytest.approx(expected, abs=1e-4 * weight)


def test_heave_frequency_by_formula() -> None:
    """w^2 = sum_i k_i (dl_i/dz)^2 / m for a payload whose centre is on the axis of symmetry."""
    cab = compact(10e3, size=2.0)
    plant = Hexapod(cab, "hardware")
    springs = stiffness(plant.hydraulics.cylinder, plant.hydraulics.oil.bulk_modulus, np.zeros(6))
    along = pose_jacobian(np.zeros(6))[:, 2]
    modes = plant.hydraulic_modes()
    heave = int(np.argmax(modes.share[2]))
    assert modes.frequency[heave] == pytest.approx(np.sqrt(springs @ along**2 / 10e3), rel=1e-3)


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
