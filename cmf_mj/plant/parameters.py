"""Hydraulic parameters: cylinders, servo-valves, oil, losses and the supply.

The numbers live in `hydraulics.toml`; this module names, checks and loads them. A set describes one
actuator, which all are equal to unless `actuators` says otherwise, and the supply they share.
Symbols: Ac, Ar cap and rod area, h half stroke, beta effective bulk modulus, Ps, Pt supply and
return pressure.

>>> cmf_mj.load_hydraulics("report").name
'report'
"""

from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import create_model, model_validator

from cmf_mj.core import quantity as kind
from cmf_mj.core.errors import InputError, check_name
from cmf_mj.core.quantity import Quantity
from cmf_mj.core.settings import Fitting, Loader, Name, Settings, merged, validated
from cmf_mj.machine.machine import Machine, load_machine

VALVES = ("valve_1", "valve_2")  #: Servo-valves of an actuator; it may have the first alone.

OF_THE_SUPPLY = ("precharge_pressure", "relief_pressure", "proof_pressure")
"""Pressures in proportion to the supply pressure."""


class _Valve(Settings):
    """What may differ from valve to valve."""

    drive_lag: kind.Corner  #: Corner of the servo drive's first-order lag.
    valve_lag: kind.Corner  #: Corner of the spool's first-order lag.
    valve_flow: kind.Ratio  #: Rated flow over the nominal, its share of what `leg_speed` needs.
    null_bias: kind.Bias  #: Spool position at no command, in full strokes of the spool.
    overlap: kind.Share  #: Spool travel either side of centre that opens nothing, in full strokes.
    hysteresis: kind.Share  #: Full width of the play between drive and spool, in full strokes.
    threshold_pressure: kind.Gauge  #: Supply over return pressure below which the valve is shut.


class _Actuator(_Valve):
    """What may differ from actuator to actuator."""

    bore_diameter: kind.Length  #: Diameter of the cylinder bore.
    rod_diameter: kind.Length  #: Diameter of the rod; smaller than the bore.
    rods: kind.OneOrTwo  #: Rod ends: 1, or 2 of a rod that passes through: symmetric, Ac = Ar.
    valves: kind.OneOrTwo  #: Servo-valves: 1, or 2 in tandem that share the flow.
    half_stroke: kind.Length  #: Half of the mechanical stroke, the chamber lengths at neutral.
    minimum_gap: kind.Length  #: Length of a chamber at its stop, neared over twenty times as much.
    cap_dead_volume: kind.DeadVolume
    """Oil between piston and valve beside the cap chamber's, with the bulk modulus of all oil: a
    volume V in hoses of modulus Bh counts as V (1/Bo + 1/Bh) times the bulk modulus."""
    rod_dead_volume: kind.DeadVolume  #: The same on the rod's side.
    cap_throttle: kind.Line  #: Laminar resistance between valves and cap chamber, both ways.
    rod_port: kind.Ratio  #: Flow gain of rod ports over matched ones; Ac / Ar where all are equal.
    rest_pressure: kind.Gauge  #: Rod pressure at the start without leakage; 0: null of the valve.
    leg_speed: kind.LegSpeed  #: Steady leg speed per command at half the supply pressure a port.
    leak_rate: kind.Rate
    """Rate lambda at which piston leakage relaxes a force built up by displacing the leg at
    neutral; the leg mode of frequency w has the damping ratio lambda / (2 w)."""
    bearing_leakage: kind.Conductance  #: Leakage of the rod bearing, from rod chamber to return.
    coulomb_friction: kind.Force  #: Friction of steady sliding.
    breakaway_friction: kind.Force  #: Friction that begins to slide, at least `coulomb_friction`.
    stribeck_speed: kind.Speed  #: Speed over which friction falls from breakaway to Coulomb.
    presliding: kind.Length  #: Elastic travel of a sticking contact at the Coulomb force.
    viscous_friction: kind.Viscous  #: Friction per speed.
    cushion_length: kind.Travel  #: Travel before each stop in which outflow is throttled, or 0.
    cushion_opening: kind.Opening  #: Opening of the throttle at the stop, over that of both valves.
    supply_hose: kind.Line  #: Laminar resistance from the supply manifold to the actuator's valves.
    return_hose: kind.Line  #: Laminar resistance from the actuator's valves to the return manifold.
    settle_speed: kind.Speed  #: Speed at which the settle valve lowers the leg under `settle_load`.
    settle_load: kind.Force  #: Load `settle_speed` refers to.


VALVE_FIELDS = tuple(_Valve.model_fields)  #: Quantities that may differ from valve to valve.

ACTUATOR_FIELDS = tuple(_Actuator.model_fields)  #: Quantities that may differ between actuators.


def _optional(model: type[Settings]) -> dict[str, Any]:
    return {name: (kind.optional(info), None) for name, info in model.model_fields.items()}


ValveChanges = create_model("ValveChanges", __base__=Settings, **_optional(_Valve))
"""What one valve has different from the set."""

ActuatorChanges = create_model(
    "ActuatorChanges",
    __base__=Settings,
    **_optional(_Actuator) | {name: (ValveChanges | None, None) for name in VALVES},
)
"""What one actuator has different from the set, with tables `valve_1` and `valve_2`."""


class HydraulicParameters(_Actuator):
    """Parameters of the actuators with their valves, the oil and the supply."""

    name: Name  #: Name of the set.
    supply: Literal["constant", "network"]  #: Constant pressure, or pump with accumulators.
    actuators: Mapping[str, ActuatorChanges] = {}
    """What single actuators, by the names of their motors, have different from the set."""
    bulk_modulus: kind.Pressure  #: Effective bulk modulus, with hoses and barrel.
    oil_density: kind.Density  #: Density of the oil; only a burst hose needs it.
    cavitation_gas: kind.Share  #: Gas released below the atmosphere, volume share; 0: no floor.
    entrained_gas: kind.Share  #: Undissolved gas at atmospheric pressure, volume share.
    gas_exponent: kind.Exponent  #: Polytropic exponent of entrained gas; at least 1.
    transition_pressure: kind.Pressure  #: Drop of an orifice, half laminar and half turbulent.
    proof_pressure: kind.Pressure  #: Chamber pressure beyond which a run is stopped with an error.
    supply_pressure: kind.Pressure  #: Set pressure of the pump, or of a constant supply, gauge.
    return_pressure: kind.Gauge  #: Tank pressure, gauge.
    pump_flow: kind.Flow  #: Largest flow of the pumping unit.
    pump_droop: kind.Pressure  #: Fall of pressure from no flow to full flow of the compensator.
    pump_lag: kind.Time  #: Time constant of the compensator.
    pump_line: kind.Line  #: Laminar resistance from the pump to the supply manifold.
    relief_pressure: kind.Pressure  #: Supply manifold pressure at which the relief valve opens.
    relief_conductance: kind.Conductance  #: Flow of the relief valve per excess of pressure.
    accumulator_count: kind.Count  #: Accumulators on the supply manifold, a whole number or 0.
    accumulator_volume: kind.Volume  #: Gas volume of one accumulator at precharge.
    precharge_pressure: kind.Pressure  #: Gas pressure of an accumulator without oil, gauge.
    accumulator_exponent: kind.Exponent  #: Polytropic exponent of the accumulators' gas.
    accumulator_line: kind.Resistance  #: Laminar resistance from one to the supply manifold.
    supply_volume: kind.Volume  #: Oil volume of the supply manifold and its lines.
    return_volume: kind.Volume  #: Oil volume of the return manifold and its lines.
    tank_line: kind.Resistance  #: Laminar resistance from the return manifold to the tank.
    isolation_time: kind.Time
    """Time in which an emergency stop shuts the valves off and opens the settle valves."""

    @model_validator(mode="after")
    def _check_consistency(self) -> "HydraulicParameters":
        for name in ("", *self.actuators):
            numbers = self.actuator(name)
            where = f"actuators.{name}." if name else ""
            _check_order(numbers, where, "rod_diameter", "bore_diameter")
            _check_order(numbers, where, "minimum_gap", "half_stroke")
            _check_order(numbers, where, "coulomb_friction", "breakaway_friction", equal=True)
            if numbers["coulomb_friction"].value == 0.0 < numbers["breakaway_friction"].value:
                raise InputError(
                    f"{where}breakaway_friction: {numbers['breakaway_friction']} needs a "
                    f"coulomb_friction greater than 0"
                )
        quantities = self.quantities()
        _check_order(quantities, "", "return_pressure", "supply_pressure")
        _check_order(quantities, "", "precharge_pressure", "supply_pressure")
        _check_order(quantities, "", "supply_pressure", "relief_pressure", equal=True)
        _check_order(quantities, "", "relief_pressure", "proof_pressure")
        if self.accumulator_count.value != int(self.accumulator_count.value):
            raise InputError(
                f"accumulator_count: {self.accumulator_count.value:g} must be a whole number"
            )
        for field in ("gas_exponent", "accumulator_exponent"):
            if getattr(self, field).value < 1.0:
                raise InputError(f"{field}: {getattr(self, field).value:g} must be at least 1")
        return self

    @property
    def cap_area(self) -> float:
        """Ac, area of the piston on the cap side [m^2]."""
        return cap_area(self.quantities())

    @property
    def rod_area(self) -> float:
        """Ar, annulus on the rod side [m^2]."""
        return rod_area(self.quantities())

    def quantities(self) -> dict[str, Quantity]:
        """All numbers of the set by name, in the order of the class."""
        return {name: value for name, value in self if isinstance(value, Quantity)}

    def actuator(self, name: str = "", valve: int | None = None) -> dict[str, Quantity]:
        """All numbers of an actuator, or of its valve 0 or 1; by default those of the set."""
        numbers = self.quantities()
        changes = self.actuators.get(name)
        valve_changes = None if valve is None else getattr(changes, VALVES[valve], None)
        for table in (changes, valve_changes):
            numbers |= {field: value for field, value in table or () if isinstance(value, Quantity)}
        return numbers


def _check_order(
    values: Mapping[str, Quantity], where: str, small: str, large: str, *, equal: bool = False
) -> None:
    lower, upper = values[small], values[large]
    if lower.si > upper.si or (lower.si == upper.si and not equal):
        bound = "at most" if equal else "less than"
        raise InputError(f"{where}{small}: {lower} must be {bound} {large}, {upper}")


def cap_area(values: Mapping[str, Quantity]) -> float:
    """Ac [m^2] of an actuator's quantities."""
    second_rod = (values["rods"].si - 1.0) * values["rod_diameter"].si ** 2
    return np.pi / 4.0 * (values["bore_diameter"].si ** 2 - second_rod)


def rod_area(values: Mapping[str, Quantity]) -> float:
    """Ar [m^2] of an actuator's quantities."""
    return np.pi / 4.0 * (values["bore_diameter"].si ** 2 - values["rod_diameter"].si ** 2)


def piston_leakage(values: Mapping[str, Quantity]) -> float:
    """Laminar piston leakage L [m^3/s/Pa], flow = L (p_cap - p_rod).

    A force built up by displacing the leg at neutral begins to relax at the rate
    4 beta L / (h (Ac + Ar)), which is `leak_rate` and damps the leg mode; slower by the volumes of
    hoses and dead ends, which are left out here.
    """
    area = cap_area(values) + rod_area(values)
    rate, half = values["leak_rate"].si, values["half_stroke"].si
    return rate * half * area / (4.0 * values["bulk_modulus"].si)


HYDRAULICS = ("report", "hardware", "lossy")  #: Names of the shipped parameter sets.


load_hydraulics = Loader(
    HydraulicParameters,
    Path(__file__).with_name("hydraulics.toml"),
    what="hydraulics",
    names=HYDRAULICS,
    default="hardware",
    levels=0,
)
"""Loads a hydraulic parameter set: `report`, `hardware`, `lossy`, or a file with `base`
naming one of them and one table of changes."""


def hydraulics_of(
    machine: Machine, source: str | Path | HydraulicParameters | None = None
) -> HydraulicParameters:
    """A hydraulic set, by default that of the machine, whose half stroke its cylinders have."""
    return _machine_set(machine) if source is None else load_hydraulics(source)


@lru_cache
def _machine_set(machine: Machine) -> HydraulicParameters:
    if isinstance(machine.hydraulics, str):
        return load_hydraulics(machine.hydraulics)
    where, changes = f"{machine.name}: hydraulics", dict(machine.hydraulics)
    base = load_hydraulics(
        check_name(f"{where}: base", changes.pop("base", "hardware"), HYDRAULICS)
    )
    for field, owner in (("name", "machine"), ("half_stroke", "table legs")):
        if field in changes:
            raise InputError(f"{where}: {field}: is taken from the {owner}; leave it out")
    numbers = {"name": machine.name, "half_stroke": machine.legs.half_stroke}
    return validated(
        HydraulicParameters, merged(base.model_dump(exclude_none=True), changes, 0) | numbers, where
    )


@lru_cache
def fitting(machine: Machine) -> Fitting | None:
    """Fits shipped settings, whose numbers are the CMF's, to another machine; None for the CMF.

    Ranges, thresholds, tolerances and noise go with what they belong to: lengths with the half
    stroke, speeds with the limit of leg velocity, pressures with the supply. All else stays.
    """
    sizes, cmf_sizes = _sizes(machine), _sizes(load_machine())
    if sizes == cmf_sizes:
        return None
    scale = {unit: size / cmf_sizes[unit] for unit, size in sizes.items()}
    return partial(_scale_table, scale, machine.name)


def _sizes(machine: Machine) -> dict[str, float]:
    """Half stroke, leg velocity and supply pressure by the units of what goes with them."""
    sizes = dict.fromkeys(("in", "m", "mm"), machine.half_stroke)
    sizes |= dict.fromkeys(("in/s", "m/s", "mm/s"), machine.limits.leg.velocity.si)
    pressure = hydraulics_of(machine).supply_pressure.si
    return sizes | dict.fromkeys(("psi", "Pa", "bar"), pressure)


def _scale_table(scale: dict[str, float], name: str, table: dict[str, Any]) -> dict[str, Any]:
    """A table with its quantities in proportion; tables in it likewise."""
    factor = scale.get(str(table.get("unit", "")).removesuffix("/rtHz"))
    if factor is not None:
        source = f"{table['source']}; of the CMF, here in proportion to {name}"
        return table | {"value": table["value"] * factor, "source": source}
    return {
        key: _scale_table(scale, name, entry) if isinstance(entry, dict) else entry
        for key, entry in table.items()
    }
