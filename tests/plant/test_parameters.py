"""Hydraulic parameter sets: published areas, units, sources, user files and their refusals."""

import numpy as np
import pytest
from pydantic import ValidationError

from cmf_mj import load_hydraulics
from cmf_mj.core import units
from cmf_mj.plant.parameters import HYDRAULICS, HydraulicParameters

DESIGN_MASS = 7200.0 * units.POUND_MASS


def quantity(value, unit, status="assumed", source="test"):
    return f'{{ value = {value}, unit = "{unit}", status = "{status}", source = "{source}" }}'


@pytest.fixture
def own(tmp_path):
    """Writes a parameter file: `own("leak_rate = ...")` on top of the hardware set."""

    def write(changes="", base="hardware"):
        path = tmp_path / "mine.toml"
        path.write_text(f'base = "{base}"\n[mine]\n{changes}\n')
        return path

    return write


# The shipped sets


@pytest.mark.parametrize("name", HYDRAULICS)
def test_a_shipped_set_has_the_published_areas_modes_and_lags(name):
    """23.758 and 11.965 in^2 to the digits that the docs print (section 3.4.1 prints 11.97), their
    ratio of the pressure gains of Table 2-2, 1.949e-7 / 9.816e-8 = 1.9855; the oil spring of the
    pole pair of Eq 4.1, -0.807 +- 70.999j, modulus 71.0035 rad/s, with 7200 lbm; the lags of Eqs
    4.1 and 4.4, -18.85 and -471.24 rad/s; and leg speeds of 0.27 to 0.352 in/s per %, derived from
    the printed transfer functions."""
    p = load_hydraulics(name)
    assert abs(p.cap_area / units.INCH**2 - 23.758) < 5e-4
    assert abs(p.rod_area / units.INCH**2 - 11.965) < 5e-4
    assert abs(p.cap_area / p.rod_area - 1.949e-7 / 9.816e-8) < 5e-4
    spring = p.bulk_modulus.si * (p.cap_area + p.rod_area) / p.half_stroke.si
    assert abs(np.sqrt(spring / DESIGN_MASS) - 71.0035) < 0.01
    assert abs(p.drive_lag.si - 18.85) < 0.005
    assert abs(p.valve_lag.si - 471.24) < 0.005
    assert 0.27 <= p.leg_speed.value <= 0.352


def test_leak_rate_of_the_report_set_damps_the_pole_pair():
    """Real part 0.807 1/s: half the rate at which a held leg's force relaxes."""
    assert abs(load_hydraulics("report").leak_rate.si / 2.0 - 0.807) < 1e-12


@pytest.mark.parametrize("name", HYDRAULICS)
def test_every_quantity_has_unit_status_and_source(name):
    quantities = load_hydraulics(name).quantities()
    others = {"name", "supply", "actuators"}
    assert set(quantities) == set(HydraulicParameters.model_fields) - others
    for entry in quantities.values():
        assert entry.status in ("stated", "derived", "calibrated", "assumed")
        assert len(entry.source) > 10
        assert entry.si == entry.value * units.factor(entry.unit)


def test_sets_differ_only_in_what_is_calibrated():
    """Leg speed and leakage; the rest is the same machine, the report's on a constant supply."""
    report, hardware = (load_hydraulics(name) for name in ("report", "hardware"))
    mine, other = report.quantities(), hardware.quantities()
    assert {n for n in mine if mine[n] != other[n]} == {"leg_speed", "leak_rate"}
    assert (report.supply, hardware.supply) == ("constant", "network")


def test_lossy_is_hardware_with_losses():
    """Nothing but losses differs, each off in the hardware set."""
    hardware, lossy = (load_hydraulics(name) for name in ("hardware", "lossy"))
    mine, other = hardware.quantities(), lossy.quantities()
    differ = {n for n in mine if mine[n].si != other[n].si}
    assert differ == {
        *("null_bias", "overlap", "hysteresis", "bearing_leakage", "entrained_gas"),
        *("coulomb_friction", "breakaway_friction", "viscous_friction", "cushion_length"),
    }
    assert all(mine[n].value == 0.0 < other[n].value for n in differ)
    assert hardware.supply == lossy.supply == "network"


def test_hardware_is_the_default_and_a_loaded_set_passes_through_unchanged(own):
    assert load_hydraulics() == load_hydraulics("hardware")
    assert load_hydraulics(str(own())).name == "mine"
    loaded = load_hydraulics("report")
    assert load_hydraulics(loaded) is loaded
    with pytest.raises(ValidationError, match="frozen"):
        loaded.name = "other"
    with pytest.raises(ValidationError, match="frozen"):
        loaded.leak_rate.value = 3.0


# A user's file


@pytest.mark.parametrize("base", HYDRAULICS)
def test_own_set_changes_only_what_it_names(own, base):
    path = own(f"leak_rate = {quantity(25.0, '1/s')}", base=base)
    found, shipped = load_hydraulics(path), load_hydraulics(base)
    assert found.name == "mine"
    assert found.leak_rate.si == 25.0
    changed = {n for n, q in found.quantities().items() if q != shipped.quantities()[n]}
    assert changed == {"leak_rate"}


# Refusals: field, value, what is allowed


def refusal(path):
    with pytest.raises(ValueError) as caught:
        load_hydraulics(path)
    return str(caught.value)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"leak_rat = {quantity(25.0, '1/s')}", ["leak_rat: is not a known field", "valve_lag"]),
        (
            f"leak_rate = {quantity(25.0, '1/s').replace('}', ', note = 3 }')}",
            ["leak_rate.note: is not a known field", "source, status, unit, value"],
        ),
        *(
            (f"{field} = {quantity(value, unit)}", [f"{field}: ", str(value), bound])
            for field, value, unit, bound in (
                ("rod_diameter", 6.25, "in", "less than bore_diameter"),
                ("minimum_gap", 60.5, "in", "less than half_stroke"),
                ("return_pressure", 1600.5, "psi", "less than supply_pressure"),
                ("precharge_pressure", 1500.5, "psi", "less than supply_pressure"),
                ("supply_pressure", 1700.5, "psi", "at most relief_pressure"),
                ("relief_pressure", 6000.5, "psi", "less than proof_pressure"),
                ("coulomb_friction", 10.5, "lbf", "at most breakaway_friction"),
                ("breakaway_friction", 20.5, "lbf", "needs a coulomb_friction greater than 0"),
                ("accumulator_count", 2.5, "1", "a whole number"),
                ("gas_exponent", 0.95, "1", "at least 1"),
            )
        ),
        (
            f"bore_diameter = {quantity(0.1397, 'm')}\nrod_diameter = {quantity(6.25, 'in')}",
            ["rod_diameter: 6.25 in", "bore_diameter, 0.1397 m"],
        ),
        *(
            (f"[mine.actuators.leg_3{part}]\n{field} = {quantity(7.0, 'in')}", [words])
            for part, field, words in (
                ("", "rod_diameter", "actuators.leg_3.rod_diameter: 7 in must"),
                ("", "pump_flow", "actuators.leg_3.pump_flow: is not a known"),
                (".valve_1", "leak_rate", "leg_3.valve_1.leak_rate: is not a"),
                (".valve_3", "null_bias", "leg_3.valve_3: is not a known"),
                (".valve_1", "null_bias", "leg_3.valve_1.null_bias: "),
            )
        ),
    ],
)
def test_a_refusal_names_field_value_and_what_is_allowed(own, line, words):
    """In a few lines on the quantity at fault, not the whole set."""
    message = refusal(own(line))
    assert message.count("mine.toml: mine: ") == len(message.splitlines())
    assert all(word in message for word in words), message
    assert "source = " not in message


def test_published_units_convert() -> None:
    """0.35 in/s/% is 0.35 * 0.0254 / 0.01 m/s of full command; 3 Hz is 6 pi rad/s; 1500 psi is
    10.342 MPa (NIST SP 811: 1 psi = 6894.757 Pa)."""
    p = load_hydraulics("hardware")
    assert p.leg_speed.si == pytest.approx(0.35 * 0.0254 / 0.01, rel=1e-14)
    assert p.drive_lag.si == pytest.approx(6 * np.pi, rel=1e-14)
    assert p.supply_pressure.si == pytest.approx(1500 * 6894.757, rel=1e-7)


# Actuators and valves of their own


def test_an_actuator_and_a_valve_may_differ(own):
    """Each number comes from the valve, else the actuator, else the set."""
    table = f"""
    [mine.actuators.leg_3]
    leak_rate = {quantity(25.0, "1/s")}
    null_bias = {quantity(2.0, "%")}
    [mine.actuators.leg_3.valve_2]
    null_bias = {quantity(-1.0, "%")}
    """
    p = load_hydraulics(own(table))
    assert p.actuator("leg_1") == p.quantities() == load_hydraulics(own()).quantities()
    assert p.actuator("leg_3")["leak_rate"].value == 25.0
    assert p.actuator("leg_3", 0)["null_bias"].value == 2.0
    assert p.actuator("leg_3", 1)["null_bias"].value == -1.0
    assert p.actuator("leg_3", 1)["leak_rate"].value == 25.0
    assert p.actuator("leg_3")["bore_diameter"] == p.bore_diameter
