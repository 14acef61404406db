"""Laws in hydraulic modes on a user's cab."""

from pathlib import Path

import numpy as np
import pytest

from cmf_mj import Hexapod, load_law, signals, simulate
from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.modes import bound
from cmf_mj.control.coordinates import make_shape, mode_mass
from cmf_mj.control.law import Law
from cmf_mj.core.settings import validated
from cmf_mj.facility.replay import replay
from cmf_mj.facility.scenario import scenario_of
from cmf_mj.machine.cab import load_cab, recorded_cab
from cmf_mj.record.record import Record

MODAL = load_law("modal_plan")
HEAVY = load_cab("ifd").changed("heavy", mass=14e3, centre_of_mass=(0.2, 0.1, 1.1))


def test_modes_of_a_user_s_cab_diagonalise_its_reflected_mass() -> None:
    """V^T M_leg V = diag(m), with M_leg and V from different roots: the plant, and the law."""
    law = bound(MODAL, HEAVY)
    modes = law.bound_modes
    assert modes is not None
    assert list(law.modes) == ["heavy"]
    shape = make_shape(modes, 6)
    mass = shape @ Hexapod(HEAVY).reflected_mass() @ shape.T
    assert mass == pytest.approx(np.diag(mode_mass(modes)), abs=1e-6 * mass.max())


@pytest.mark.parametrize("name", ["gfd", "rfd", "ifd"])
def test_the_numbers_of_a_shipped_cab_have_its_modes(name: str) -> None:
    """Computed, they are those that the shipped table prints, to its digits and a sign."""
    again = load_cab(name).changed("again", mass=load_cab(name).mass.si)
    found, shipped = bound(MODAL, again).bound_modes, MODAL.modes[name]
    assert found is not None
    assert found.frequency == pytest.approx(shipped.frequency, rel=1e-5)
    assert found.mass == pytest.approx(shipped.mass, rel=1e-5)
    overlap = np.array(found.shape) @ np.array(shipped.shape).T
    assert np.abs(overlap) == pytest.approx(np.eye(6), abs=1e-8)


def test_a_law_that_names_the_cab_keeps_its_modes() -> None:
    own = MODAL.model_copy(update={"modes": {"heavy": MODAL.modes["gfd"]}})
    assert bound(own, HEAVY).modes == own.modes
    assert bound(load_law("velocity"), HEAVY) == load_law("velocity")


def test_a_cab_taken_for_another_has_that_one_s_modes() -> None:
    """What the control law knows is not what is there."""
    drawn = load_cab("gfd").changed("drawn", mass=11e3, nominal=load_cab("gfd"))
    plant = Hexapod(drawn)
    assert bound(MODAL, plant.law_key) == MODAL.bound_to("gfd")
    assert plant.reflected_mass()[0, 0] > Hexapod("gfd").reflected_mass()[0, 0]


def test_a_shipped_cab_without_modes_is_refused() -> None:
    own = MODAL.model_copy(update={"modes": {"gfd": MODAL.modes["gfd"]}})
    with pytest.raises(ValueError, match="modes: law modal_plan has none of 'rfd'; it has gfd"):
        bound(own, load_cab("rfd"))


@pytest.fixture(scope="module")
def run() -> Record:
    return simulate(Hexapod(HEAVY), MODAL, signals.step("heave", 0.01, duration=1.5))


def test_a_run_says_which_cab_it_was(run: Record, tmp_path: Path) -> None:
    again = Record.load(run.save(tmp_path / "run.parquet"))
    assert again.metadata["cab"] == "heavy"
    assert recorded_cab(again.metadata) == HEAVY
    recorded = validated(Law, again.metadata["law_parameters"], "law_parameters")
    assert recorded.modes == bound(MODAL, HEAVY).modes
    assert recorded_cab({"cab": "rfd"}) == load_cab("rfd")
    assert recorded_cab({}) is None


def test_a_run_is_replayed_with_the_modes_of_its_cab(run: Record) -> None:
    assert replay(run, "modal_plan").identical
    assert not replay(run, bound_to_another()).identical


def bound_to_another() -> Law:
    return MODAL.model_copy(update={"modes": {"heavy": MODAL.modes["gfd"]}})


def test_the_law_is_stable_on_the_linear_plant_of_the_cab() -> None:
    """And other modes than the cab's make another loop."""
    system = linearize(Hexapod(HEAVY))
    own, other = (
        np.abs(closed_loop(law, system).poles())
        for law in (bound(MODAL, HEAVY), bound_to_another())
    )
    assert own.max() < 1.0
    assert np.sort(own) != pytest.approx(np.sort(other), abs=1e-6)


def test_scenarios_take_files_counted_from_their_folder(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text('base = "rfd"\n[mine]\n')
    table = {"cab": "mine.toml", "law": "modal_plan"}
    scenario = scenario_of(table, "test", tmp_path)
    assert scenario.cab == str(tmp_path / "mine.toml")
    assert scenario.first_law().modes == bound(MODAL, load_cab(scenario.cab)).modes
    with pytest.raises(ValueError, match="test: cab: 'bus' is not one of gfd"):
        scenario_of({"cab": "bus"}, "test")
