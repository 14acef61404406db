"""Performance envelope: the largest sine that holds, per degree of freedom and frequency.

A sine is faded in, runs until the machine has settled, and is judged over whole cycles. It holds
if every ratio of a quantity to its limit is at most 1:

    displacement     largest demand or response over the operational limits (Table 2-1)
    leg_stroke       largest demand or extension of a leg over the working stroke of 37.5 in
    valve_command    largest compensator output, before the clamp, over 100 %
    supply_pressure  fall of the supply manifold over the fall that is allowed
    pump_flow        mean flow drawn over the pump's largest; the accumulators must be in a
                     periodic state, losing less than 2 % of the pump's flow over the cycles
    physical_bounds  the run left the model (a chamber's proof pressure, a stop, a limit cycle)

The ratios grow nearly in proportion to the amplitude. The search starts from the closed forms,
scales by the largest ratio and, once it has an amplitude that holds and one that does not,
interpolates between their logarithms.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.control.law import Law, load_law
from cmf_mj.core.errors import InputError
from cmf_mj.core.threads import on_threads
from cmf_mj.core.units import RATE
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.cab import Cab, load_cab
from cmf_mj.machine.geometry import DOFS, dof_index
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.plant.parameters import HydraulicParameters, hydraulics_of
from cmf_mj.record.record import Record
from cmf_mj.signals.composite import stepped_sines
from cmf_mj.signals.signal import Command, check_positive
from cmf_mj.studies.asymptotes import Asymptotes, asymptotes
from cmf_mj.studies.capacity import least_allowed, relief_flow

FREQUENCIES = (0.1, 0.16, 0.25, 0.4, 0.63, 1.0, 1.6, 2.5, 4.0, 6.3, 10.0)
"""Frequencies of the envelope [Hz], five a decade (R5 series)."""

QUICK_FREQUENCIES = (0.1, 0.4, 1.6, 6.3)
"""Frequencies of a quick envelope [Hz]."""

_CLOSE = 0.98
"""A largest ratio above this ends the search."""
_AIM = 0.993
"""Largest ratio the search aims at."""
_RUNS = 9
_INTERPOLATED = 5
"""Runs after which the bracket is halved instead."""
_LARGEST_STEP = 4.0
_PERIODIC = 0.02
"""Oil the accumulators may lose over the cycles judged, as a share of the pump's flow."""
_SMALLEST = 1e-3
"""Share of the closed-form limit below which nothing holds."""


_NAN = float("nan")


class EnvelopePoint(NamedTuple):
    """The largest sine that holds at one frequency; NaN where none does.

    Displacement, velocity and acceleration are amplitudes of the platform's fundamental.
    """

    dof: str  #: Degree of freedom.
    frequency: float  #: [Hz].
    command: float  #: Amplitude of the demand [m, rad].
    displacement: float = _NAN  #: Amplitude of the response [m, rad].
    velocity: float = _NAN  #: Amplitude of the response [m/s, rad/s].
    acceleration: float = _NAN  #: Amplitude of the response [m/s^2, rad/s^2].
    binding: str = ""  #: The limit that binds, a name of the list above.
    ratio: float = _NAN  #: How far it is used.
    distortion: float = _NAN
    """Rms of what is not the fundamental, over rms of the fundamental, of the displacement."""
    least_pressure: float = _NAN  #: Least manifold pressure over the cycles [Pa].
    drawn_flow: float = _NAN
    """Mean flow drawn from the supply [m^3/s]; NaN with a constant supply."""
    runs: int = 0  #: Simulations it took.


@dataclass(frozen=True)
class Envelope:
    """Envelopes of several degrees of freedom, with their closed-form asymptotes."""

    law: str
    cab: str
    hydraulics: str
    allowed_pressure: float  #: Least manifold pressure [Pa].
    points: tuple[EnvelopePoint, ...]  #: By degree of freedom, then frequency.
    asymptotes: tuple[Asymptotes, ...]  #: By degree of freedom.

    def of(self, dof: str) -> list[EnvelopePoint]:
        """Points of one degree of freedom."""
        return [point for point in self.points if point.dof == dof]


class _Run(NamedTuple):
    """One sine, judged."""

    ratios: dict[str, float]
    point: EnvelopePoint

    @property
    def binding(self) -> str:
        return max(self.ratios, key=lambda name: self.ratios[name])

    @property
    def largest(self) -> float:
        return self.ratios[self.binding]


def largest_sine(
    plant: Hexapod,
    law: str | Law,
    dof: str,
    frequency: float,
    *,
    least_pressure: float | None = None,
) -> EnvelopePoint:
    """The largest sustained sine that holds at a frequency.

    `least_pressure` of the supply manifold [Pa] defaults to 80 % of the set. The largest ratio of
    the point lies between 0.98 and 1; or less, where a ratio jumps.
    """
    check_positive(frequency=frequency)
    allowed = least_allowed(plant.parameters, least_pressure)
    loaded = load_law(law)
    start = asymptotes(plant, dof).velocity(frequency) / (2.0 * np.pi * frequency)
    below: _Run | None = None
    above: _Run | None = None
    amplitude, runs = start, 0
    while runs < _RUNS and amplitude > _SMALLEST * start:
        runs += 1
        run = _run(plant, loaded, dof, frequency, amplitude, allowed)
        if run.largest <= 1.0:
            below = run
            if run.largest >= _CLOSE:
                break
        else:
            above = run
        amplitude = _next(below, above, halve=runs >= _INTERPOLATED)
        if below and above and above.point.command / below.point.command < 1.01:
            break
    if below is None:
        binding = "physical_bounds" if above is None else above.binding
        return EnvelopePoint(dof, frequency, _NAN, binding=binding, runs=runs)
    binding = above.binding if above is not None and below.largest < _CLOSE else below.binding
    return below.point._replace(binding=binding, ratio=below.largest, runs=runs)


def _next(below: _Run | None, above: _Run | None, *, halve: bool) -> float:
    """The next amplitude to try."""
    aim = np.log(_AIM)
    ends = [run for run in (below, above) if run is not None]
    if len(ends) < 2:
        most = np.log(_LARGEST_STEP)
        change = np.clip(aim - np.log(ends[0].largest), -most, most)
        return float(ends[0].point.command * np.exp(change))
    low, high = (np.log(run.point.command) for run in ends)
    g_low, g_high = (np.log(run.largest) for run in ends)
    share = 0.5 if halve else np.clip((aim - g_low) / (g_high - g_low), 0.1, 0.9)
    return float(np.exp(low + share * (high - low)))


def _run(
    plant: Hexapod, law: Law, dof: str, frequency: float, amplitude: float, allowed: float
) -> _Run:
    """A sustained sine without its end, judged over whole cycles."""
    cycles, every = max(1, int(np.ceil(2.0 * frequency))), 4
    before = {"settle": 0.125, "fade": 1.0 + 0.25 / frequency}
    before["transient"] = max(3.0, 1.0 / frequency)
    whole = stepped_sines(dof, [frequency], [amplitude], cycles=cycles, **before)
    start = sum(round(part * RATE) for part in before.values())
    end = start + round(cycles / frequency * RATE)
    command = Command(whole.pose[:end], whole.signal)
    try:
        record = simulate(plant, law, command, record_every=every)
    except FloatingPointError:
        return _Run({"physical_bounds": 2.0}, EnvelopePoint(dof, frequency, amplitude))
    rows = slice(-(-start // every), None)
    index = dof_index(dof)
    pose, demand = record["platform_pose"][rows], command.pose[start:end]
    pressure = record["supply_pressure"][rows]
    supply = plant.hydraulics.supply
    legs = max(float(np.abs(record[n][rows]).max()) for n in ("leg_reference", "leg_extension"))
    limits = load_motion_limits(None, plant.machine).operational
    excursion = np.vstack([demand[::every], pose])
    used = np.maximum(excursion / limits[:, 1], excursion / limits[:, 0]).max()
    ratios = {
        "displacement": float(used),
        "leg_stroke": legs / plant.machine.working_stroke,
        "valve_command": float(np.abs(record["compensator_output"][rows]).max()),
        "supply_pressure": float((supply.pressure - pressure.min()) / (supply.pressure - allowed)),
    }
    drawn = _NAN
    if not supply.constant:
        drawn, ratios["pump_flow"] = _flow(plant, record, rows)
    rate = 2.0 * np.pi * frequency
    fit = fit_sines(pose[:, index], rate * record.time[rows])
    reached = float(np.abs(fit.amplitude[0]))
    point = EnvelopePoint(
        dof=dof,
        frequency=frequency,
        command=amplitude,
        displacement=reached,
        velocity=reached * rate,
        acceleration=reached * rate**2,
        distortion=float(np.sqrt(2.0 * np.mean(fit.remainder**2)) / reached),
        least_pressure=float(pressure.min()),
        drawn_flow=drawn,
    )
    return _Run(ratios, point)


def _flow(plant: Hexapod, record: Record, rows: slice) -> tuple[float, float]:
    """Mean flow drawn from the supply manifold [m^3/s], and its ratio to what can be sustained."""
    supply = plant.hydraulics.supply
    oil = supply.accumulators * record["accumulator_oil"][rows] + record["supply_content"][rows]
    time = record.time[rows]
    lost = float(oil[0] - oil[-1]) / float(time[-1] - time[0])
    delivered = record["pump_flow"][rows] - relief_flow(plant.parameters, record)[rows]
    drawn = float(delivered.mean()) + lost
    ratio = drawn / supply.pump_flow
    if lost > _PERIODIC * supply.pump_flow:
        ratio = max(ratio, 1.0 + lost / supply.pump_flow - _PERIODIC)
    return drawn, ratio


def performance_envelope(
    law: str | Law = "velocity",
    cab: str | Path | Cab | None = None,
    hydraulics: str | Path | HydraulicParameters | None = None,
    *,
    dofs: Sequence[str] = DOFS,
    frequencies: Sequence[float] = FREQUENCIES,
    least_pressure: float | None = None,
    jobs: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Envelope:
    """The largest sustained sine of every degree of freedom at every frequency.

    `least_pressure` of the supply manifold [Pa] defaults to 80 % of the set; `progress` is called
    with (points done, points in all). What is refused is named before anything runs.
    """
    loaded, carried = load_law(law), load_cab(cab)
    parameters = hydraulics_of(carried.machine, hydraulics)
    allowed = least_allowed(parameters, least_pressure)
    for field, chosen in (("dofs", dofs), ("frequencies", frequencies)):
        if not chosen:
            raise InputError(f"{field}: is empty; at least one is needed")
    for dof in dofs:
        dof_index(dof)
    for frequency in frequencies:
        check_positive(frequencies=frequency)
        if frequency > RATE / 32:
            raise InputError(f"frequencies: {frequency} Hz must be at most {RATE / 32} Hz")
    cases = [(dof, float(frequency)) for dof in dofs for frequency in frequencies]

    def point(case: tuple[str, float]) -> EnvelopePoint:
        return largest_sine(Hexapod(carried, parameters), loaded, *case, least_pressure=allowed)

    points = on_threads(point, cases, jobs, progress)
    plant = Hexapod(carried, parameters)
    limits = tuple(asymptotes(plant, dof) for dof in dict.fromkeys(dofs))
    names = loaded.name, carried.name, parameters.name
    return Envelope(*names, allowed, tuple(points), limits)
