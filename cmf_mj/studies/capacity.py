"""Does the supply hold through a manoeuvre?

It holds if the supply manifold never falls below a least pressure, by default 80 % of the set
pressure. A leg that carries the load F moves at a speed in proportion to the root of the drop

    d = (A_cap Ps - F) / (A_cap + A_rod) outwards,    d = (A_rod Ps + F) / (A_cap + A_rod) inwards

across its ports. At 0.8 of 1500 psi and 7200 lbf the root, and the loop gain, has fallen by 13 %
outwards, as far as the report's fits to its hardware differ (Eqs 4.4, 4.12, 4.15, 4.18), and by 7 %
inwards.

Manoeuvres go by name, or come from a file of a host's frames: time and six poses in SI, joined by
quintics.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cmf_mj import signals
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError, unknown_name
from cmf_mj.core.result import Field
from cmf_mj.core.settings import validated
from cmf_mj.facility.signal import HostFile
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.geometry import dof_unit
from cmf_mj.machine.machine import Machine, load_machine
from cmf_mj.machine.models import CMF
from cmf_mj.machine.motion_limits import relative_travel
from cmf_mj.plant.hydraulics import Hydraulics
from cmf_mj.plant.parameters import HydraulicParameters
from cmf_mj.plant.plant import Plant
from cmf_mj.record.record import Record
from cmf_mj.signals.peaks import check_limits
from cmf_mj.signals.signal import Command, commanded
from cmf_mj.studies.case import frames_a_row
from cmf_mj.studies.failure import Peak, extreme

SIGNALS = ("sine", "step", "chirp", "noise", "multisine")  #: Manoeuvres with a name.

_SIZES = {"sine": 15.0, "step": 10.0, "chirp": 1.0, "noise": 3.0, "multisine": 3.0}
"""Default amplitudes on the CMF [in or deg]."""

_FREQUENCIES = {"sine": 0.25, "chirp": 2.0, "noise": 1.0, "multisine": 1.0}
"""Default frequency of the sine, and default highest frequency of the others [Hz]."""

_CYCLES, _SECONDS = 5.0, 20.0  #: A sine lasts so many cycles, and so long, at least.


def manoeuvre(
    name: str | Path,
    dof: str,
    amplitude: float | None = None,
    frequency: float | None = None,
    machine: str | Path | Machine = CMF,
) -> Command:
    """A manoeuvre by name or file.

    `name` is one of `SIGNALS`, or a CSV or Parquet file of frames. `amplitude` [m or rad] and
    `frequency` [Hz], the highest of a chirp, of noise and of a multisine, are for named signals.
    The default amplitude goes with the operational travel of the `machine`.
    """
    kind = str(name)
    if kind not in SIGNALS:
        for field, value in (("amplitude", amplitude), ("frequency", frequency)):
            if value is not None:
                raise InputError(f"{field}: {value:g} is not allowed; a file of poses has its own")
        if Path(kind).suffix not in (".csv", ".parquet"):
            raise unknown_name("signal", kind, SIGNALS, " nor a .csv or .parquet file")
        return validated(HostFile, {"kind": "host", "file": kind}, "signal").command()
    size = amplitude
    if size is None:
        size = units.to_si(dof_unit(dof), _SIZES[kind]) * relative_travel(
            load_machine(machine), dof
        )
    if kind == "step":
        if frequency is not None:
            raise InputError(f"frequency: {frequency:g} Hz is not allowed; a step has none")
        return signals.step(dof, size)
    rate = _FREQUENCIES[kind] if frequency is None else frequency
    options: dict[str, Any] = {"stop": rate}
    if kind == "sine":
        signals.check_positive(frequency=rate)
        cycles = max(_CYCLES, np.ceil(_SECONDS * rate))
        options = {"frequency": rate, "cycles": cycles, "fade": 1.0 / rate}
    elif kind != "noise":
        options["fade"] = 1.0 if kind == "chirp" else 2.0
    command: Command = getattr(signals, kind)(dof, size, **options)
    return command


LEAST_PRESSURE = 0.8  #: Least manifold pressure, as a share of the set pressure.

_SATURATED = 1.0 - 1e-9
_ROWS = 512
"""Rows of the record in a second, about: every fourth control frame at the CMF, whose fastest mode
is at some 15 Hz."""


class Flow(NamedTuple):
    """A flow over a whole run."""

    mean: float  #: [m^3/s].
    peak: float  #: [m^3/s].


class CapacityResult(NamedTuple):
    """What a manoeuvre took out of the supply.

    NaN where a constant supply has no such thing.
    """

    holds: bool  #: Whether the supply manifold stayed above `allowed_pressure`.
    allowed_pressure: float  #: Least pressure that the criterion allows [Pa].
    least_pressure: Peak  #: Least pressure of the supply manifold [Pa].
    least_oil: float  #: Least oil in all accumulators together [m^3].
    charged_oil: float  #: Oil in them at the start [m^3].
    least_gas_pressure: float  #: Least gas pressure of the accumulators [Pa].
    empty_time: float  #: How long they were empty [s].
    pump_flow: Flow
    pump_flow_limit: float  #: What the pump can give [m^3/s].
    relief_flow: Flow
    saturation: NDArray[np.float64]
    """Share of the run each valve command stood at its stops, (n,)."""
    peak_command: NDArray[np.float64]
    """Largest compensator output, before the clamp, as a fraction, (n,)."""
    least_margin: Peak  #: Least pressure margin of all legs [Pa], see `pressure_margin`.
    record: Record  #: The run, at about 512 Hz.


CAPACITY = (
    Field("holds", "supply holds", lambda holds: "yes" if holds else "NO"),
    Field("allowed_pressure", "pressure to keep", ".0f psi", "psi", about="of the manifold"),
    Field("least_pressure", "least manifold pressure", ".0f psi", "psi", "least_pressure.value"),
    Field("least_pressure_at", "  at", ".2f s", of="least_pressure.time"),
    Field("charged_oil", "oil in accumulators", ".1f gal", "gal", about="charged"),
    Field("least_oil", "least oil in accumulators", ".1f gal", "gal"),
    Field("least_gas_pressure", None, ".0f psi", "psi", about="of the accumulators"),
    Field("empty_time", "accumulators empty", ".3g s", about="in all"),
    Field("mean_pump_flow", None, ".0f gpm", "gpm", "pump_flow.mean", about="over the run"),
    Field("peak_pump_flow", None, ".0f gpm", "gpm", "pump_flow.peak"),
    Field("pump_flow_limit", None, ".0f gpm", "gpm"),
    Field("mean_relief_flow", None, ".0f gpm", "gpm", "relief_flow.mean", about="over the run"),
    Field("peak_relief_flow", None, ".0f gpm", "gpm", "relief_flow.peak"),
    Field("valve_saturation", None, ".2f %", "%", lambda one: max(one.saturation)),
    Field("peak_valve_demand", None, ".0f %", "%", lambda one: max(one.peak_command)),
    Field("worst_leg", "  of leg", "d", of=lambda one: 1 + one.peak_command.argmax()),
    Field("least_pressure_margin", None, ".0f psi", "psi", "least_margin.value"),
    Field("least_margin_leg", "  of leg", "d", of="least_margin.leg", about="manifold over stall"),
    Field("least_margin_at", "  at", ".2f s", of="least_margin.time"),
)
"""Saturation is a share of the run, of the worst leg; demand is before the clamp at 100 %."""


def least_allowed(parameters: HydraulicParameters, least_pressure: float | None = None) -> float:
    """Least manifold pressure of the criterion [Pa].

    `least_pressure` is gauge [Pa], by default `LEAST_PRESSURE` of the set pressure.
    """
    least, most = parameters.return_pressure.si, parameters.supply_pressure.si
    chosen = LEAST_PRESSURE * most if least_pressure is None else least_pressure
    if not least < chosen < most:
        raise InputError(
            f"least_pressure: {chosen:.6g} Pa must be between the tank's {least:.6g} Pa "
            f"and the supply's {most:.6g} Pa"
        )
    return chosen


def pressure_margin(hydraulics: Hydraulics, record: Record) -> NDArray[np.float64]:
    """Pressure by which the manifold exceeds what would just stall each leg [Pa], (N, n).

    A force F, positive extending, needs the supply pressure (F + A_rod Pt) / A_cap with the valve
    open one way and (A_cap Pt - F) / A_rod with it open the other way; the larger is taken off.
    """
    cylinder = hydraulics.cylinder
    load = record["leg_force"]
    low = record["return_pressure"][:, None]
    out = (load + cylinder.rod_area * low) / cylinder.cap_area
    back = (cylinder.cap_area * low - load) / cylinder.rod_area
    return np.asarray(record["supply_pressure"][:, None] - np.maximum(out, back))


def capacity(
    command: Command | ArrayLike,
    plant: Plant,
    law: str | Law = "velocity",
    *,
    least_pressure: float | None = None,
) -> CapacityResult:
    """Run a manoeuvre and say whether the supply holds through it.

    `command` is a `Command` or platform poses (N, 6) at the machine's control rate [m, rad], z
    down, within the operational limits. `least_pressure` is gauge [Pa], by default 80 % of the set
    pressure. Raises FloatingPointError where the state leaves its physical bounds.
    """
    machine, parameters, supply = plant.machine, plant.parameters, plant.hydraulics.supply
    demanded = commanded(command, machine.rate)
    check_limits(demanded, machine=machine)
    allowed = least_allowed(parameters, least_pressure)
    record = simulate(plant, law, demanded, record_every=frames_a_row(machine, _ROWS))
    pressure, pump, oil = (
        record[name] for name in ("supply_pressure", "pump_flow", "accumulator_oil")
    )
    known = np.nan if supply.constant else 1.0
    output = np.abs(record["compensator_output"])
    over = np.maximum(pressure - parameters.relief_pressure.si, 0.0)
    margin = pressure_margin(plant.hydraulics, record)
    whole = np.full(record.time.size, True)

    def flow(history: NDArray[np.float64]) -> Flow:
        return Flow(known * float(history.mean()), known * float(history.max()))

    return CapacityResult(
        holds=bool(pressure.min() >= allowed),
        allowed_pressure=allowed,
        least_pressure=extreme(record.time, pressure, whole, np.negative),
        least_oil=known * supply.accumulators * float(oil.min()),
        charged_oil=known * supply.accumulators * float(oil[0]),
        least_gas_pressure=known * float(record["accumulator_pressure"].min()),
        empty_time=known * np.count_nonzero(oil <= 1e-6 * oil[0]) / record.rate,
        pump_flow=flow(pump),
        pump_flow_limit=known * supply.pump_flow,
        relief_flow=flow(parameters.relief_conductance.si * over),
        saturation=(output >= _SATURATED).mean(axis=0),
        peak_command=output.max(axis=0),
        least_margin=extreme(record.time, margin, whole, np.negative),
        record=record,
    )
