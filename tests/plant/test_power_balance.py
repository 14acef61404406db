"""Balances of energy and oil: against the state itself, and against sums done by hand."""

import numpy as np
import pytest
from hydraulic_equations import oil_content, stored_energy

from cmf_mj import Hexapod, SingleLegs, drive, load_hydraulics
from cmf_mj.plant.power_balance import power_balance

LEVER = np.linspace(0.0, 0.3, 2048)[:, None] * np.array([1.0, -1.0, 0.5, 1.0, 0.0, -0.5])


def pressurised(name):
    """A set whose tank stands under 50 psi."""
    parameters = load_hydraulics(name)
    tank = parameters.return_pressure.model_copy(update={"value": 50.0})
    return parameters.model_copy(update={"return_pressure": tank})


SETS = ["hardware", "lossy", "report", pressurised("hardware"), pressurised("report")]


@pytest.mark.parametrize("hydraulics", SETS)
def test_the_balance_is_that_of_the_hydraulic_state(hydraulics, monkeypatch):
    """Same sums from the state that `advance` kept: contents, not pressures."""
    plant = SingleLegs(hydraulics)
    kept = []
    start = plant.start
    monkeypatch.setattr(plant, "start", lambda pose=None: kept.append(start(pose)) or kept[-1])
    first = plant.start()
    begin = (
        oil_content(plant.hydraulics, first),
        stored_energy(plant.hydraulics, first, plant.extensions()),
    )
    record = drive(plant, LEVER)
    state = kept[-1]
    balance = power_balance(plant, record)
    assert balance.oil[0] == pytest.approx(begin[0], rel=1e-12)
    assert balance.oil[-1] == pytest.approx(oil_content(plant.hydraulics, state), rel=1e-12)
    rise = stored_energy(plant.hydraulics, state, plant.extensions()) - begin[1]
    assert balance.stored[-1] == pytest.approx(rise, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("hydraulics", SETS)
def test_nothing_is_left_over(hydraulics):
    plant = Hexapod(hydraulics=hydraulics)
    balance = power_balance(plant, drive(plant, LEVER))
    assert balance.delivered[-1] > 1e4
    assert np.abs(balance.residual).max() < 1e-3 * balance.delivered[-1]
    assert balance.oil == pytest.approx(balance.oil[0], rel=1e-6)
    assert (balance.lost > -1e-6).all()
    assert balance.work[-1] + balance.stored[-1] == pytest.approx(
        balance.delivered[-1] - balance.lost[-1], rel=1e-3
    )


def test_a_chamber_torn_open_is_not_a_number():
    """Legs let go under a load that pulls: rod chambers empty faster than they fill."""
    plant = SingleLegs("hardware", static_load=-70e3)
    lever = np.ones((1024, 6))
    record = drive(plant, lever)
    torn = np.minimum(record["cap_pressure"], record["rod_pressure"]).min(axis=1) < 0.0
    assert 10 < torn.sum() < 1014
    balance = power_balance(plant, record)
    assert np.array_equal(np.isnan(balance.oil), torn)
    assert np.array_equal(np.isnan(balance.residual), torn)


def test_a_record_of_another_plant_is_refused():
    record = drive(SingleLegs(), np.zeros((4, 6)))
    with pytest.raises(ValueError, match="record: its model_digest is not that of hexapod"):
        power_balance(Hexapod(), record)
    with pytest.raises(ValueError, match="record: its hydraulic_parameters is not that of single"):
        power_balance(SingleLegs("lossy"), record)
