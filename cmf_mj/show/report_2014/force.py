"""Force feedback: why the legs oscillate, how fast, and what the report's 25 Hz would need.

The loop broken at the valve command, with leg plant P and DCL C in discrete time,

    L(f) = C(e^(2 pi i f T)) P(e^(2 pi i f T)) e^(-2 pi i f T),

oscillates where the phase of L is a whole turn. A command clamped at 100 % lowers the gain and
leaves the phase: a limit cycle ends up between the frequency of the unstable poles and this one.
"""

from typing import NamedTuple

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.linear.assembly import linearize
from cmf_mj.analysis.linear.law import DCL_INPUTS, FEEDBACK, dcl_state_space
from cmf_mj.analysis.linear.loop import closed_loop
from cmf_mj.analysis.linear.reduction import leg_model
from cmf_mj.analysis.measures import Measures
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import Law
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME
from cmf_mj.plant.parameters.hydraulics import HydraulicParameters
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.record.record import Record
from cmf_mj.show.chart import Chart, Panel, curve
from cmf_mj.show.look import COLOURS
from cmf_mj.show.report_2014.contents import (
    Block,
    PageFigure,
    PageTable,
    TableRow,
    captioned,
    table,
    texts,
)
from cmf_mj.show.report_2014.runs import FORCE_READINGS, Runs, RunSpec, hydraulics_of, law_of
from cmf_mj.show.report_2014.tables import printed_number as number

REPORTED_HZ, REPORTED_G = 25.0, 3.0
"""Of the oscillation in Figures 3-20 and 3-21, section 3.4.2."""

_FREQUENCY = np.geomspace(2.0, 100.0, 4000)
_HIGHEST = 200.0
_TAIL = 4.0
"""Length of the steady oscillation examined [s]."""


class Oscillation(NamedTuple):
    """What the linear loop says; NaN where it has no such thing."""

    pole_hz: float  #: Modulus of the least damped pair.
    pole_damping: float  #: Its damping ratio, negative where it grows.
    crossover_hz: float
    """Where the phase of the open loop is a whole turn, at the highest gain there."""
    crossover_gain: float  #: Of the open loop there; above 1 the loop oscillates.


def open_loop(law: Law, leg: control.StateSpace, f: NDArray[np.float64]) -> NDArray[np.complex128]:
    """L at `f` [Hz], (K,): from the command at the valve around to the DCL's output."""
    omega = 2.0 * np.pi * f
    held = control.sample_system(leg, FRAME, method="zoh", copy_names=True)
    plant = control.frequency_response(held, omega).frdata[:, 0, :]
    dcl = control.frequency_response(dcl_state_space(law), omega).frdata[0]
    rows = {name: plant[held.output_labels.index(name)] for name in FEEDBACK}
    total = sum(dcl[DCL_INPUTS.index(name)] * rows[name] for name in FEEDBACK)
    return np.asarray(total * np.exp(-1j * omega * FRAME))


def oscillation(law: Law, parameters: HydraulicParameters) -> Oscillation:
    """Least damped poles and phase crossover of one leg under a law."""
    leg = leg_model(linearize(SingleLegs(parameters)), 1)
    poles = np.log(closed_loop(law, leg).poles().astype(complex)) / FRAME
    poles = poles[(poles.imag > 0.0) & (np.abs(poles) < 2.0 * np.pi * _HIGHEST)]
    # Pairs that are all but real belong to the law's integrator, not to an oscillation.
    damping = -poles.real / np.abs(poles)
    oscillating = (damping < 0.9) & (np.abs(poles) > 2.0 * np.pi * 4.0)
    worst = poles[oscillating][np.argmin(damping[oscillating])]
    loop = open_loop(law, leg, _FREQUENCY)
    turns = np.flatnonzero((loop.imag[1:] * loop.imag[:-1] < 0.0) & (loop.real[1:] > 0.0))
    crossover, gain = float("nan"), float("nan")
    if turns.size:
        at = turns[np.argmax(np.abs(loop[turns]))]
        crossover, gain = float(_FREQUENCY[at]), float(np.abs(loop[at]))
    return Oscillation(
        float(np.abs(worst) / (2.0 * np.pi)),
        float(-worst.real / np.abs(worst)),
        crossover,
        gain,
    )


class Reading(NamedTuple):
    """One reading of the force gain: linear loop, simulated step, simulated response."""

    title: str
    gain: float  #: [%/lbf].
    linear: Oscillation
    cycle_hz: float
    """Of the pressure difference in the last seconds of the step; NaN where it has died down."""
    pressure: float  #: Its amplitude [psi].
    acceleration: float  #: Largest leg acceleration in these seconds [g].
    measures: Measures  #: Of chirp and step.


def cycle(record: Record) -> tuple[float, float, float]:
    """Frequency [Hz], amplitude [psi] and largest acceleration [g] at the end of a run."""
    tail = round(_TAIL * record.rate)
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[-tail:, 0])
    acceleration = float(np.abs(record["leg_acceleration"][-tail:, 0]).max())
    acceleration /= units.STANDARD_GRAVITY
    swing = difference - difference.mean()
    amplitude = float(np.ptp(swing)) / 2.0
    if amplitude < 10.0:
        return float("nan"), amplitude, acceleration
    spectrum = np.abs(np.fft.rfft(swing * np.hanning(tail)))
    return float(np.argmax(spectrum) / _TAIL), amplitude, acceleration


def force_law(reading: str) -> str:
    """Name of the law with this reading; the first reading is the shipped law."""
    return "force" if reading == next(iter(FORCE_READINGS)) else f"force:{reading}"


FORCE_NEEDS = tuple(RunSpec("model", force_law(reading)) for reading in FORCE_READINGS)
"""Runs of the study."""


def readings(runs: Runs) -> list[Reading]:
    """All readings of the gain."""
    parameters = hydraulics_of("model")
    rows = []
    for title, gain in FORCE_READINGS.items():
        name = force_law(title)
        result = runs.case("model", name)
        linear = oscillation(law_of(name), parameters)
        rows.append(Reading(title, gain, linear, *cycle(result.step), result.measures))
    return rows


class Variation(NamedTuple):
    """The loop with one number of the plant changed."""

    title: str
    linear: Oscillation


def _varied(field: str, value: float) -> HydraulicParameters:
    base = hydraulics_of("model")
    quantity = getattr(base, field).model_copy(update={"value": value})
    return base.model_copy(update={field: quantity})


def variations() -> list[Variation]:
    """The printed gains around plants with other oil, lags and leakage."""
    law = law_of("force")
    changes = (
        ("report set", "leak_rate", hydraulics_of("model").leak_rate.value),
        ("leakage of the hardware set, 15 1/s", "leak_rate", 15.0),
        ("valve lag 300 Hz for 75", "valve_lag", 300.0),
        ("drive lag 8.3 Hz for 3, so that sqrt(8.3 x 75) = 25 Hz", "drive_lag", 8.3),
        ("oil 2 times as stiff", "bulk_modulus", 2e5),
        ("oil 3.1 times as stiff", "bulk_modulus", 3.1e5),
        ("oil 4.9 times as stiff: leg mode at 25 Hz", "bulk_modulus", 4.9e5),
    )
    return [Variation(title, oscillation(law, _varied(f, v))) for title, f, v in changes]


def _gain_chart() -> Chart:
    """Frequency and damping of the least damped pair over the force gain."""
    parameters = hydraulics_of("model")
    sizes = np.geomspace(0.1, 10.0, 41)
    base = law_of("force")

    def at(size: float) -> Oscillation:
        gains = base.direct_gain.model_copy(update={"force": -0.01 * float(size)})
        return oscillation(base.model_copy(update={"direct_gain": gains}), parameters)

    poles, damping, crossover, _ = zip(*map(at, sizes), strict=True)
    frequencies = (
        curve("unstable poles", sizes, poles, COLOURS[0]),
        curve("phase crossover", sizes, crossover, COLOURS[1], "dash"),
    )
    ratio = Panel(
        "damping ratio of the poles",
        (curve("unstable poles", sizes, damping, COLOURS[0]),),
        guides=(0.0,),
        x_title="force gain over the printed 0.01 % per lbf",
        x_range=(0.1, 10.0),
        x_log=True,
    )
    frequency = Panel("frequency [Hz]", frequencies, (5.0, 30.0), guides=(REPORTED_HZ,))
    return captioned("force_gain", (frequency, ratio), {})


def _readings_table(rows: list[Reading]) -> PageTable:
    cells: list[TableRow | tuple[str, ...]] = [
        (
            r.title,
            f"{r.gain:+.3g}",
            f"{number(r.linear.pole_hz)} / {r.linear.pole_damping:+.3f}",
            f"{number(r.linear.crossover_hz)} / {number(r.linear.crossover_gain, 2)}",
            number(r.cycle_hz),
            f"{r.pressure:.0f}",
            f"{r.acceleration:.1f}",
            number(r.measures.phase_bandwidth_hz),
            number(r.measures.gain_bandwidth_hz),
            f"{r.measures.peak_gain_db:.1f}",
        )
        for r in rows
    ]
    printed = next(
        r for r in published_results() if r.law == "force" and r.phase_bandwidth_hz is not None
    )
    widths = (f"{printed.phase_bandwidth_hz:g}", f"{printed.gain_bandwidth_hz:g}", "about 1")
    last = ("printed", "", "", "", f"{REPORTED_HZ:g}", "", f"{REPORTED_G:g}", *widths)
    return table("force-readings", [*cells, TableRow(last, "reported")])


def blocks(runs: Runs) -> list[Block]:
    """The section on the oscillation of section 3.4.2."""
    rows = readings(runs)
    first, second, third = texts(
        "force",
        reported_hz=REPORTED_HZ,
        reported_g=REPORTED_G,
        cycle_hz=number(rows[0].cycle_hz),
        acceleration=rows[0].acceleration,
        pressure=rows[0].pressure,
    )
    title = "Least damped poles over the force gain"
    changed = [
        (
            v.title,
            number(v.linear.pole_hz),
            f"{v.linear.pole_damping:+.3f}",
            number(v.linear.crossover_hz),
            number(v.linear.crossover_gain, 2),
        )
        for v in variations()
    ]
    return [
        *(first, _readings_table(rows), second),
        *(PageFigure("figure-force", title, _gain_chart()), table("force-variations", changed)),
        third,
    ]
