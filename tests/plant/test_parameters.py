"""Hydraulic parameter sets: published areas, units, sources, user files and their refusals."""

import re

import numpy as np
import pytest
from pydantic import ValidationError

from cmf_mj import load_hydraulics
from cmf_mj.core import units
from cmf_mj.plant.parameters import HYDRAULICS, HydraulicParameters, piston_leakage

DESIGN_MASS = 7200.0 * units.POUND_MASS


def quantity(value, unit, status="assumed", source="test"):
    return f'{{ value = {value}, unit = "{unit}", status = "{status}", source = "{source}" }}'


@pytest.fixture
def own(tmp_path):
    """Writes a parameter file: `own("leak_rate = ...")` on top of the hardware set."""

    def write(changes="", base='base = "hardware"', table="[mine]"):
        path = tmp_path / "mine.toml"
        path.write_text(f"{base}\n{table}\n{changes}\n")
        return path

    return write


# The shipped sets


@pytest.mark.parametrize("name", HYDRAULICS)
def test_areas_are_the_published_ones(name):
    """23.758 and 11.965 in^2 to the digits that the docs print; section 3.4.1 prints 11.97."""
    parameters = load_hydraulics(name)
    assert abs(parameters.cap_area / units.INCH**2 - 23.758) < 5e-4
    assert abs(parameters.rod_area / units.INCH**2 - 11.965) < 5e-4


@pytest.mark.parametrize("name", HYDRAULICS)
def test_area_ratio_is_that_of_the_pressure_gains(name):
    """Table 2-2: 1.949e-7 / 9.816e-8 = 1.9855."""
    parameters = load_hydraulics(name)
    assert abs(parameters.cap_area / parameters.rod_area - 1.949e-7 / 9.816e-8) < 5e-4


@pytest.mark.parametrize("name", HYDRAULICS)
def test_oil_spring_gives_the_leg_mode(name):
    """Eq 4.1: pole pair -0.807 +- 70.999j, modulus 71.0035 rad/s, with 7200 lbm."""
    p = load_hydraulics(name)
    spring = p.bulk_modulus.si * (p.cap_area + p.rod_area) / p.half_stroke.si
    assert abs(np.sqrt(spring / DESIGN_MASS) - 71.0035) < 0.01


@pytest.mark.parametrize("name", HYDRAULICS)
def test_lags_are_the_poles_of_the_linear_models(name):
    """Eqs 4.1 and 4.4: -18.85 and -471.24 rad/s."""
    parameters = load_hydraulics(name)
    assert abs(parameters.drive_lag.si - 18.85) < 0.005
    assert abs(parameters.valve_lag.si - 471.24) < 0.005


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
        "null_bias",
        "overlap",
        "hysteresis",
        "bearing_leakage",
        "coulomb_friction",
        "breakaway_friction",
        "viscous_friction",
        "entrained_gas",
        "cushion_length",
    }
    assert all(mine[n].value == 0.0 < other[n].value for n in differ)
    assert hardware.supply == lossy.supply == "network"


def test_leg_speeds_lie_in_the_published_range():
    """0.27 to 0.352 in/s per % (derived from the printed transfer functions)."""
    for name in HYDRAULICS:
        assert 0.27 <= load_hydraulics(name).leg_speed.value <= 0.352


def test_leakage_relaxes_the_force_of_a_held_leg_at_the_leak_rate():
    """By hand: dF/dt = -L (pc - pr) beta (1 + 1) / h with pc = -pr = F / (Ac + Ar)."""
    p = load_hydraulics("hardware")
    cap = 1.0 / (p.cap_area + p.rod_area)  # pressures of a unit force
    flow = piston_leakage(p.quantities()) * 2.0 * cap
    cap_fall = p.bulk_modulus.si * flow / (p.cap_area * p.half_stroke.si)
    rod_rise = p.bulk_modulus.si * flow / (p.rod_area * p.half_stroke.si)
    rate = p.cap_area * cap_fall + p.rod_area * rod_rise
    assert abs(rate / p.leak_rate.si - 1.0) < 1e-12


def test_hardware_is_the_default():
    assert load_hydraulics() == load_hydraulics("hardware")


def test_loaded_set_passes_through():
    loaded = load_hydraulics("report")
    assert load_hydraulics(loaded) is loaded


def test_sets_are_immutable():
    loaded = load_hydraulics("report")
    with pytest.raises(ValidationError, match="frozen"):
        loaded.name = "other"
    with pytest.raises(ValidationError, match="frozen"):
        loaded.leak_rate.value = 3.0


# A user's file


@pytest.mark.parametrize("base", HYDRAULICS)
def test_own_set_changes_only_what_it_names(own, base):
    path = own(f"leak_rate = {quantity(25.0, '1/s')}", base=f'base = "{base}"')
    found, shipped = load_hydraulics(path), load_hydraulics(base)
    assert found.name == "mine"
    assert found.leak_rate.si == 25.0
    changed = {n for n, q in found.quantities().items() if q != shipped.quantities()[n]}
    assert changed == {"leak_rate"}


def test_own_set_may_use_other_units(own):
    path = own(f"bore_diameter = {quantity(0.1397, 'm')}")
    assert abs(load_hydraulics(path).cap_area / units.INCH**2 - 23.758) < 5e-4


def test_path_may_be_text(own):
    assert load_hydraulics(str(own())).name == "mine"


def test_leakage_may_be_zero(own):
    tight = load_hydraulics(own(f"leak_rate = {quantity(0.0, '1/s')}"))
    assert piston_leakage(tight.quantities()) == 0.0


# Refusals: field, value, what is allowed


def refusal(path):
    with pytest.raises(ValueError) as caught:
        load_hydraulics(path)
    return str(caught.value)


def test_unknown_field_lists_the_fields(own):
    message = refusal(own(f"leak_rat = {quantity(25.0, '1/s')}"))
    assert "mine.toml: mine: leak_rat: is not a known field" in message
    assert "leak_rate" in message and "valve_lag" in message


def test_unknown_key_of_a_quantity_lists_the_keys(own):
    entry = quantity(25.0, "1/s").replace("}", ', note = "x" }')
    message = refusal(own(f"leak_rate = {entry}"))
    assert "mine: leak_rate.note: is not a known field" in message
    assert "source, status, unit, value" in message


@pytest.mark.parametrize(
    ("field", "unit", "allowed"),
    [
        ("leak_rate", "Hz", "1/s"),
        ("bore_diameter", "psi", "in, m"),
        ("supply_pressure", "in", "psi, Pa"),
        ("drive_lag", "s", "Hz, rad/s"),
        ("leg_speed", "in/s", "in/s/%, m/s/%"),
    ],
)
def test_unit_of_another_dimension_names_the_allowed_ones(own, field, unit, allowed):
    message = refusal(own(f"{field} = {quantity(1.0, unit)}"))
    assert f"mine: {field}: " in message
    assert repr(unit) in message and f"unit must be one of {allowed}" in message


def test_unknown_unit_lists_the_units(own):
    message = refusal(own(f"leak_rate = {quantity(1.0, 'furlong')}"))
    assert "mine: leak_rate.unit: 'furlong' is refused" in message
    assert "psi" in message


@pytest.mark.parametrize(
    ("field", "value", "unit", "allowed"),
    [
        ("leak_rate", -25.5, "1/s", "at least 0 1/s"),
        ("return_pressure", -1.5, "psi", "at least 0 psi"),
        ("bore_diameter", 0.0, "in", "greater than 0 in"),
        ("bulk_modulus", -3.0, "psi", "greater than 0 psi"),
        ("supply_pressure", -5.0, "psi", "greater than 0 psi"),
        ("leg_speed", 0.0, "in/s/%", "greater than 0 in/s/%"),
    ],
)
def test_value_out_of_range_names_field_value_and_range(own, field, value, unit, allowed):
    message = refusal(own(f"{field} = {quantity(value, unit)}"))
    assert f"mine: {field}: " in message
    assert str(value) in message and allowed in message


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_value_must_be_finite(own, value):
    message = refusal(own(f"leak_rate = {quantity(value, '1/s')}"))
    assert f"mine: leak_rate.value: {value} is refused: input should be a finite number" in message


@pytest.mark.parametrize("value", ['"high"', '"25"', "true"])
def test_value_must_be_a_number(own, value):
    message = refusal(own(f"leak_rate = {quantity(value, '1/s')}"))
    assert "mine: leak_rate.value: " in message


def test_status_must_be_a_known_one(own):
    message = refusal(own(f"leak_rate = {quantity(1.0, '1/s', status='guessed')}"))
    assert "mine: leak_rate.status: 'guessed' is refused" in message
    assert "'stated', 'derived', 'calibrated', 'assumed', 'published' or 'recalled'" in message


def test_source_must_not_be_empty(own):
    message = refusal(own(f"leak_rate = {quantity(1.0, '1/s', source='')}"))
    assert "mine: leak_rate.source: '' is refused" in message


def test_missing_keys_are_named_each(own):
    message = refusal(own("leak_rate = { value = 1.0 }"))
    for key in ("unit", "status", "source"):
        assert f"mine: leak_rate.{key}: is missing" in message


def test_bare_number_is_refused(own):
    assert "mine: leak_rate: 25.0 is refused" in refusal(own("leak_rate = 25.0"))


def test_all_faults_are_reported_at_once(own):
    message = refusal(
        own(f"bulk_modulus = {quantity(-3.0, 'psi')}\nleak_rate = {quantity(-1.0, '1/s')}")
    )
    assert len(message.splitlines()) == 2
    assert "bulk_modulus" in message and "leak_rate" in message


@pytest.mark.parametrize(
    ("field", "value", "unit"),
    [
        ("rod_diameter", 6.25, "in"),
        ("minimum_gap", 60.5, "in"),
        ("return_pressure", 1600.5, "psi"),
        ("precharge_pressure", 1500.5, "psi"),
        ("supply_pressure", 1700.5, "psi"),
        ("relief_pressure", 6000.5, "psi"),
        ("coulomb_friction", 10.5, "lbf"),
        ("accumulator_count", 2.5, "1"),
        ("gas_exponent", 0.95, "1"),
    ],
)
def test_quantities_that_contradict_name_field_and_value(own, field, value, unit):
    """One line on the quantity at fault, not the whole set."""
    message = refusal(own(f"{field} = {quantity(value, unit)}"))
    assert f"mine: {field}: " in message
    assert str(value) in message
    assert "source" not in message


def test_rod_limit_is_given_in_the_unit_of_the_bore(own):
    """A bore of 0.1397 m must not be reported as 0.1397 in."""
    message = refusal(
        own(f"bore_diameter = {quantity(0.1397, 'm')}\nrod_diameter = {quantity(6.25, 'in')}")
    )
    assert re.search(r"0\.1397 m\b|5\.5 in\b", message)


@pytest.mark.parametrize("base", ["", 'base = "hardwar"', 'base = ["report"]', "base = 1"])
def test_bad_base_lists_the_sets(own, base):
    message = refusal(own(base=base))
    assert "mine.toml: base: " in message and "is not one of report, hardware" in message


def test_exactly_one_table_is_allowed(own):
    assert "has the tables []; exactly one is allowed" in refusal(own(table=""))
    message = refusal(own(table="[mine]\n[yours]"))
    assert "has the tables ['mine', 'yours']; exactly one is allowed" in message


def test_not_toml_gives_line_and_column(own):
    message = refusal(own("leak_rate = = 3"))
    assert "mine.toml: is not valid TOML" in message
    assert "line 3, column" in message


def test_not_text_is_not_toml(tmp_path):
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    assert "binary.toml: is not valid TOML" in refusal(path)


def test_missing_file_is_named(tmp_path):
    assert "none.toml: cannot be read: No such file" in refusal(tmp_path / "none.toml")


@pytest.mark.parametrize("name", ["hardwar", "", "set.json"])
def test_unknown_set_lists_the_sets(name):
    said = f"hydraulics: {name!r} is not one of report, hardware, lossy nor a .toml file"
    hint = "; did you mean hardware?" if name == "hardwar" else ""
    assert refusal(name) == said + hint


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


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("[mine.actuators.leg_3]\nrod_diameter = {q}", "actuators.leg_3.rod_diameter: 7 in must"),
        ("[mine.actuators.leg_3]\npump_flow = {q}", "actuators.leg_3.pump_flow: is not a known"),
        ("[mine.actuators.leg_3.valve_1]\nleak_rate = {q}", "leg_3.valve_1.leak_rate: is not a"),
        ("[mine.actuators.leg_3.valve_3]\nnull_bias = {q}", "leg_3.valve_3: is not a known"),
        ("[mine.actuators.leg_3.valve_1]\nnull_bias = {q}", "leg_3.valve_1.null_bias: "),
    ],
)
def test_refusals_of_an_actuators_numbers_say_where(own, table, message):
    assert message in refusal(own(table.format(q=quantity(7.0, "in"))))


def test_friction_needs_a_coulomb_force(own):
    message = refusal(own(f"breakaway_friction = {quantity(20.0, 'lbf')}"))
    assert "breakaway_friction: 20 lbf needs a coulomb_friction greater than 0" in message
