"""Cabs as settings: the shipped ones, a user's file, and what physics refuses."""

import re
from pathlib import Path

import numpy as np
import pytest

import cmf_mj
from cmf_mj.core import units
from cmf_mj.machine import models
from cmf_mj.machine.cab import load_cab, recorded_cab

WHY = 'status = "assumed", source = "test"'


def written(folder: Path, text: str, base: str = "gfd") -> Path:
    path = folder / "mine.toml"
    path.write_text(f'base = "{base}"\n{text}')
    return path


def stated(key: str, value: object, unit: str) -> str:
    return f'{key} = {{ value = {value}, unit = "{unit}", {WHY} }}\n'


def test_numbers_and_units_of_a_file(tmp_path: Path) -> None:
    cab = load_cab(
        written(
            tmp_path,
            "[mine]\n"
            + stated("mass", 20000, "lbm")
            + stated("centre_of_mass", [4.0, -2, 36], "in")
            + stated("inertia", [9000.0, 12000, 14000, 100, -200, 300], "slug ft^2")
            + "[mine.platform]\n"
            + stated("mass", 5000, "kg")
            + "[mine.legs]\n"
            + stated("rod_mass", 200.0, "kg"),
        )
    )
    slug_foot = units.POUND_FORCE * units.FOOT  # 1 slug = 1 lbf s^2/ft
    assert (cab.name, cab.base) == ("mine", "gfd")
    assert cab.mass.si == pytest.approx(9071.8474, rel=1e-12)
    assert cab.centre_of_mass.si == pytest.approx([0.1016, -0.0508, 0.9144], rel=1e-12)
    assert cab.tensor == pytest.approx(
        slug_foot * np.array([[9000, 100, -200], [100, 12000, 300], [-200, 300, 14000]]), rel=1e-12
    )
    assert (cab.legs.cylinder_mass.si, cab.legs.rod_mass.si) == (300.0, 200.0)


def test_what_is_left_out_is_that_of_the_base() -> None:
    gfd, mine = load_cab("rfd"), load_cab("rfd").changed("mine", centre_of_mass=(0.0, 0.0, 1.0))
    assert (mine.mass, mine.inertia) == (gfd.mass, gfd.inertia)
    assert (mine.platform, mine.legs, mine.base) == (gfd.platform, gfd.legs, "rfd")


def test_inertia_follows_a_mass_that_changes_alone() -> None:
    """The radii of gyration stay: those of the same body of another density."""
    gfd = load_cab("gfd")
    heavy = gfd.changed("heavy", mass=2.0 * gfd.mass.si, platform={"mass": 9000.0})
    assert heavy.tensor == pytest.approx(2.0 * gfd.tensor, rel=1e-15)
    assert heavy.platform.tensor == pytest.approx(2.0 * gfd.platform.tensor, rel=1e-15)


@pytest.mark.parametrize("name", models.CABS)
def test_payload_of_point_masses(name: str) -> None:
    """Parallel axes: m1 m2 / (m1 + m2) d^2 across the line between two centres of mass."""
    shipped = load_cab(name)
    payload = shipped.payload
    a, b = shipped.mass.si, shipped.platform.mass.si
    apart = shipped.centre_of_mass.si - shipped.platform.centre_of_mass.si
    reduced = a * b / (a + b) * (apart @ apart * np.eye(3) - np.outer(apart, apart))
    assert payload.mass == pytest.approx(a + b)
    assert payload.centre == pytest.approx(shipped.platform.centre_of_mass.si + a / (a + b) * apart)
    assert payload.inertia == pytest.approx(shipped.tensor + shipped.platform.tensor + reduced)


def test_a_homogeneous_box_of_any_size_is_allowed() -> None:
    """Its moments, m (b^2 + c^2) / 12, hold the triangle inequality; a plate is at its bound."""
    generator = np.random.default_rng(0)
    for sizes in (*generator.uniform(0.01, 5.0, (50, 3)), np.array([3.0, 2.0, 0.0])):
        moments = 1000.0 * (sizes @ sizes - sizes**2) / 12.0
        turn = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        tensor = turn @ np.diag(moments) @ turn.T
        box = load_cab().changed("box", mass=1000.0, inertia=tensor)
        assert box.tensor == pytest.approx(tensor, abs=1e-9 * moments.max())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            stated("centre_of_mass", [0, 0, -4.0], "m"),
            "centre_of_mass: is -4 m above the upper gimbals, below the floor; allowed: at least "
            "-3.98 m, z is up",
        ),
        (stated("centre_of_mass", [0, 1], "m"), "centre_of_mass: has 2 values; allowed: 3"),
        (
            stated("inertia", [100, 200, 301.0], "kg m^2"),
            "inertia: principal moments are 100, 200, 301 kg m^2; allowed: none greater than the "
            "sum of the others",
        ),
        (
            stated("inertia", [100, 100, 100, 0, 0, 150], "kg m^2"),
            "inertia: principal moments are -50, 100, 250 kg m^2; allowed: all greater than 0",
        ),
        (
            "[mine.platform]\n" + stated("inertia", [1, 1, 3], "kg m^2"),
            "platform.inertia: principal moments are 1, 1, 3",
        ),
        ('base = "gfd"\n', "base: is taken from the base; leave it out"),
        ("mass = 9000.0\n", "mass: 9000.0 is refused: must be a table of value, unit, status and"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path, f"[mine]\n{text}")
    with pytest.raises(cmf_mj.InputError, match=re.escape(f"mine.toml: mine: {message}")):
        load_cab(path)


def test_no_changed_cab_has_the_name_of_a_shipped_one(tmp_path: Path) -> None:
    with pytest.raises(cmf_mj.InputError, match="'rfd' is the name of one of the machine"):
        load_cab(written(tmp_path, "[rfd]\n"))
    with pytest.raises(cmf_mj.InputError, match="'gfd' is the name of one of the machine"):
        load_cab().changed("gfd", mass=1.0)
    sly = load_cab().changed("mine", mass=1.0).model_copy(update={"name": "gfd"})
    with pytest.raises(cmf_mj.InputError, match="'gfd' is the name of one of the machine"):
        load_cab(sly)


def test_a_cab_comes_back_from_json() -> None:
    """As from the metadata of a record."""
    cab = load_cab().changed("mine", mass=9e3, nominal=load_cab("ifd"))
    assert recorded_cab({"cab_parameters": cab.model_dump(mode="json")}) == cab


def test_the_nominal_cab_is_inherited_and_on_the_same_machine() -> None:
    """As the documents say, default that of the cab that is changed."""
    gfd = load_cab("gfd")
    twice = gfd.changed("a", mass=9e3, nominal=gfd).changed("b", mass=13e3)
    assert (twice.assumed, gfd.assumed) == (gfd, gfd)
    with pytest.raises(
        cmf_mj.InputError, match="nominal: .* is one of machine 'lab'; allowed: .* 'cmf'"
    ):
        gfd.changed("mine", mass=9e3, nominal=load_cab(None, "lab"))
