"""The ladder: what each rung must do, from closed forms."""

import csv
from pathlib import Path

import matplotlib.image
import numpy as np
import pyarrow.parquet as pq
import pytest
from shared import cmf

from cmf_mj import Hexapod, load_hydraulics, signals, simulate, step_metrics
from cmf_mj.core import units
from cmf_mj.core.units import POUND_MASS
from cmf_mj.machine.cab import load_cab
from cmf_mj.machine.geometry import FLIP
from cmf_mj.machine.kinematics import pose_jacobian
from cmf_mj.machine.machine import load_machine
from cmf_mj.plant import cylinder
from cmf_mj.studies.engine import RESULTS
from cmf_mj.studies.settings import LADDER, MACHINE_RUNG, SMALL_SHARE, lump_cab, rung_named

HARDWARE = load_hydraulics("hardware")


def payload_matrix(inertia: float, *, centre_of_mass: bool, cab: str = "gfd") -> np.ndarray:
    """M (6, 6) of a rigid payload about the platform centroid, report axes, written out by hand."""
    payload = load_cab(cab).payload
    arm = payload.centre * FLIP if centre_of_mass else np.zeros(3)
    turned = inertia * FLIP[:, None] * payload.inertia * FLIP
    cross = np.array([[0, -arm[2], arm[1]], [arm[2], 0, -arm[0]], [-arm[1], arm[0], 0]])
    return np.block(
        [
            [payload.mass * np.eye(3), -payload.mass * cross],
            [payload.mass * cross, turned - payload.mass * cross @ cross],
        ]
    )


def test_payload_is_the_sum_of_platform_and_cab() -> None:
    """29 920 lbm; the centre of mass by the lever rule."""
    payload = load_cab("gfd").payload
    cab = 9071.4837104
    assert payload.mass == pytest.approx(29920.0 * units.POUND_MASS, rel=1e-9)
    height = (4500.0 * 0.05 + cab * 0.85) / (4500.0 + cab)
    assert payload.centre == pytest.approx([cab * 0.10 / (4500.0 + cab), 0.0, height])


def test_the_edited_model_with_nothing_left_out_is_the_machine() -> None:
    whole = Hexapod(lump_cab(load_cab("rfd"), leg_mass_factor=1.0))
    assert whole.reflected_mass() == pytest.approx(Hexapod("rfd").reflected_mass(), rel=1e-9)
    assert whole.static_load() == pytest.approx(Hexapod("rfd").static_load(), rel=1e-9)


@pytest.mark.parametrize(
    ("inertia", "centre_of_mass"), [(SMALL_SHARE, False), (1.0, False), (1.0, True)]
)
@pytest.mark.parametrize("pose", [np.zeros(6), [0.2, -0.1, -0.3, 0.1, 0.05, -0.2]])
def test_reflected_mass_without_legs_is_that_of_the_payload(
    inertia: float, centre_of_mass: bool, pose: np.ndarray
) -> None:
    """M_leg = J^-T M J^-1. The legs' part is linear in their inertia and is taken out so."""
    few, many = (
        Hexapod(
            lump_cab(
                load_cab("gfd"),
                inertia=inertia,
                centre_of_mass=centre_of_mass,
                leg_mass_factor=share,
            )
        ).reflected_mass(pose)
        for share in (SMALL_SHARE, 1.0)
    )
    legs = (many - few) / (1.0 - SMALL_SHARE)
    geometry = load_machine().geometry
    # At a turned pose M turns with the payload and J takes body rates: checked at neutral and, in
    # translation, at the Jacobian of the pose.
    inverse = np.linalg.inv(pose_jacobian(np.zeros(6), geometry))
    expected = inverse.T @ payload_matrix(inertia, centre_of_mass=centre_of_mass) @ inverse
    if not np.any(pose):
        assert few - SMALL_SHARE * legs == pytest.approx(
            expected, rel=1e-6, abs=1e-6 * expected.max()
        )
    shift = pose_jacobian(pose, geometry)[:, :3]
    weight = shift.T @ (few - SMALL_SHARE * legs) @ shift
    assert weight == pytest.approx(
        payload_matrix(1.0, centre_of_mass=False)[0, 0] * np.eye(3), rel=1e-6, abs=1e-3
    )


def test_point_mass_modes_from_compliance() -> None:
    """omega_x^2 = 1 / (m sum_i (J^-1)_xi^2 / k_i) of surge, sway and heave; 5.23, 5.23, 11.3 Hz."""
    plant = Hexapod(lump_cab(load_cab(), inertia=1e-4, centre_of_mass=False, leg_mass_factor=1e-6))
    inverse = np.linalg.inv(pose_jacobian(np.zeros(6), plant.machine.geometry))
    stiffness = cylinder.stiffness(
        plant.hydraulics.cylinder, plant.hydraulics.oil.bulk_modulus, np.zeros(6)
    )
    mass = load_cab("gfd").payload.mass
    compliance = np.sum(inverse[:3] ** 2 / stiffness, axis=1)
    expected = np.sort(1.0 / np.sqrt(mass * compliance))
    assert plant.hydraulic_modes().frequency[:3] == pytest.approx(expected, rel=2e-3)
    assert expected / (2.0 * np.pi) == pytest.approx([5.23, 5.23, 11.3], rel=2e-3)


def test_heave_does_not_notice_the_geometry() -> None:
    """Six legs of 7200 lbm and a point mass of 29 920 lbm have one heave mode."""
    plant = rung_named("point_mass").build("gfd", HARDWARE)
    single = rung_named("single_legs").build("gfd", HARDWARE)
    stiffness = cylinder.stiffness(
        single.hydraulics.cylinder, single.hydraulics.oil.bulk_modulus, np.zeros(6)
    )[0]
    assert isinstance(plant, Hexapod)
    heave = plant.hydraulic_modes()
    mode = int(np.argmax(np.abs(heave.pose_shape[2]) / np.linalg.norm(heave.pose_shape, axis=0)))
    assert heave.frequency[mode] == pytest.approx(
        np.sqrt(stiffness / (7200.0 * POUND_MASS)), rel=5e-3
    )


def test_raising_the_centre_of_mass_couples_surge_with_pitch_alone() -> None:
    """m h next to the diagonal; a machine that mirrors itself keeps surge out of sway."""
    matrix = payload_matrix(1.0, centre_of_mass=True)
    payload = load_cab("gfd").payload
    assert matrix[0, 4] == pytest.approx(-payload.mass * payload.centre[2])
    assert matrix[0, [1, 3, 5]] == pytest.approx(0.0)
    assert payload_matrix(1.0, centre_of_mass=False)[0, 1:] == pytest.approx(0.0)


def test_each_rung_differs_from_the_one_before_in_one_thing() -> None:
    for before, rung in zip(LADDER, LADDER[1:], strict=False):
        assert set(rung.effects) - set(before.effects) == {rung.name}
        assert set(before.effects) < set(rung.effects)
    top = LADDER[-1]
    assert MACHINE_RUNG.is_linear
    assert not top.is_linear
    assert not LADDER[0].is_linear


def test_supply_and_friction_of_the_rungs() -> None:
    lossy = load_hydraulics("lossy")
    assert rung_named("leg_inertia").hydraulics(HARDWARE).supply == "constant"
    assert rung_named("supply").hydraulics(HARDWARE) == HARDWARE
    rubbing = rung_named("friction").hydraulics(HARDWARE)
    assert rubbing.coulomb_friction == lossy.coulomb_friction
    assert rubbing.hysteresis == HARDWARE.hysteresis


def test_what_is_left_of_the_legs_keeps_pins_closed_and_the_step_fine_enough() -> None:
    """Pins within 10 micrometres; half the mechanical step moves the overshoot by less than 1 %."""
    rung = rung_named("point_mass")
    command = signals.step("surge", units.INCH, duration=6.5)
    runs = []
    for step in (None, 1.0 / 4096.0):
        cab = lump_cab(load_cab("gfd"), inertia=SMALL_SHARE, centre_of_mass=False)
        plant = Hexapod(cab, rung.hydraulics(HARDWARE), timestep=step)
        runs.append(simulate(plant, "velocity", command, record_every=8))
    assert runs[0]["gimbal_error"].max() < 10e-6
    coarse, fine = (step_metrics(run).overshoot for run in runs)
    assert coarse == pytest.approx(fine, rel=0.01)


def test_unknown_rungs_are_refused() -> None:
    with pytest.raises(ValueError, match="rungs: 'top' is not one of single_legs, point_mass"):
        rung_named("top")


def test_a_lumped_cab_weighs_as_much_and_is_known_by_its_name() -> None:
    """Laws in hydraulic modes run in those of the cab that the DCL was made for."""
    cab = load_cab("ifd")
    plant = rung_named("point_mass").build("ifd", HARDWARE)
    legs = 6.0 * SMALL_SHARE * (cab.legs.cylinder_mass.si + cab.legs.rod_mass.si)
    assert plant.model.body_mass.sum() == pytest.approx(cab.payload.mass + legs, rel=1e-12)
    assert plant.law_key == cab
    assert plant.cab == "ifd, lumped"


@pytest.mark.slow
def test_heave_keeps_its_single_leg_all_the_way_up(tmp_path: Path) -> None:
    """One degree of freedom, one law: the -90 deg bandwidth of every rung within 4 % of the first.

    Nothing but heave moves before the centre of mass leaves the centroid, in front of the legs'
    axis of symmetry.
    """
    arguments = ("study", "ablation", "--laws", "velocity", "--dofs", "heave", "--out", tmp_path)
    cmf(*arguments, "--jobs", 2, "--backend", "threading")
    rows = pq.read_table(tmp_path / RESULTS).to_pylist()
    assert [row["rung"] for row in rows] == [rung.name for rung in LADDER]
    for row in rows:
        assert row["stable"]
        assert row["phase_bandwidth_hz"] == pytest.approx(rows[0]["phase_bandwidth_hz"], rel=0.04)
        apart = row["rung"] in ("single_legs", "point_mass", "payload_inertia")
        assert (row["crosstalk_pitch"] < 1e-3) == apart, row["rung"]
    with (tmp_path / "effects.csv").open(newline="") as file:
        lines = list(csv.reader(file))
    assert lines[0] == ["adds", "heave"]
    assert [line[0] for line in lines[1:]] == [rung.name for rung in LADDER[1:]]
    picture = matplotlib.image.imread(tmp_path / "ladder.png")
    assert picture[..., :3].reshape(-1, 3).std(axis=0).min() > 0.02
