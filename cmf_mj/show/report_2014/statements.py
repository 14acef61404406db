"""Numbers that the report's text states outside its tables, and the error at rest of its laws."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cmf_mj.analysis.linear.catalogue import hardware_velocity
from cmf_mj.analysis.linear.loop import closed_loop, loop_step
from cmf_mj.analysis.linear.second_order import bandwidth_example, characteristics
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.record.record import Record
from cmf_mj.show.report_2014.curves import cases, law_title
from cmf_mj.show.report_2014.runs import LEG, Runs, Wanted, leg_motion

INTEGRAL_LAWS = ("original", "velocity", "velocity_integral", "position_error_rate")
"""Laws whose error at rest is shown, without and with the integral."""


class Statement(NamedTuple):
    """One number of the text beside ours."""

    section: str
    what: str
    unit: str
    printed: str
    computed: float
    remark: str


class RestRow(NamedTuple):
    """Where a step ends, over the demand."""

    law: str
    formula: str  #: Gains it follows from; empty with the integral.
    dc_gain: float
    model: float
    machine: float


STATEMENT_NEEDS: tuple[Wanted, ...] = (
    *cases("model", ("original", "velocity_integral", "force")),
    *cases("machine", ("original", "velocity_integral")),
    Wanted("machine", "velocity", "heave", "rise"),
)
REST_NEEDS = (*cases("model", INTEGRAL_LAWS), *cases("machine", INTEGRAL_LAWS))


def dc_gain(law_name: str) -> float:
    """Steady leg position over the demand, pressures left out: -D_r / (D_p + C B_p / (1 - A)).

    1 with the integral.
    """
    law = load_law(law_name)
    if law.uses_integral:
        return 1.0
    through = law.output_gain * law.input_gain.of_legs("position") / (1.0 - law.state_gain)
    return -law.direct_gain.of_legs("reference") / (law.direct_gain.of_legs("position") + through)


def rest_rows(runs: Runs, laws: Sequence[str] = INTEGRAL_LAWS) -> list[RestRow]:
    """Steady states of the steps of 1 in."""
    rows = []
    for name in laws:
        law = load_law(name)
        net = law.direct_gain.of_legs("position") + law.output_gain * law.input_gain.of_legs(
            "position"
        ) / (1.0 - law.state_gain)
        formula = (
            "" if law.uses_integral else f"{law.direct_gain.of_legs('reference'):g}/{-net:.2f}"
        )
        reached = (
            1.0 - runs.case("model", name).metrics.steady_state_error,
            1.0 - runs.case("machine", name).metrics.steady_state_error,
        )
        rows.append(RestRow(law.title, formula, dc_gain(name), *reached))
    return rows


def _late_acceleration(record: Record) -> float:
    """Largest leg acceleration from 1 s after a step on [g]."""
    late = record.time > record.metadata["command"]["at"] + 1.0
    return float(np.abs(record["leg_acceleration"][late]).max()) / units.STANDARD_GRAVITY


def _sensor_statements(runs: Runs) -> list[Statement]:
    effect = runs.sensors
    if effect is None:
        return []
    gravity = units.STANDARD_GRAVITY
    return [
        Statement(
            *("3.4.1", "accelerometer of a leg at rest", "g", "0.86"),
            effect.rest_reading / gravity,
            "gravity along the leg is 0.832 g; a bias makes up the rest",
        ),
        Statement(
            *("3.4.1", "delay of the accelerometer filter", "ms", "about 10"),
            1e3 * effect.delay,
            "of Eq 3.6 at 1.2 Hz; its delay at low frequency is 64 ms",
        ),
    ]


def statements(runs: Runs) -> list[Statement]:
    """All numbers of the text that a run or a formula gives."""
    model, machine = (
        {law: runs.case(on, law).metrics for law in ("original", "velocity_integral")}
        for on in ("model", "machine")
    )
    force = runs.case("model", "force")
    example = bandwidth_example()
    reference = leg_motion(runs.record("machine", "velocity", "rise"), "leg_reference", "in")
    peaks = [
        float(loop_step(closed_loop("velocity", hardware_velocity(n)), 3.0)[1].max())
        * float(reference[-1])
        for n in (1, 2)
    ]
    return [
        Statement(
            *("2.5", "overshoot of the original law, hardware", "%", "15"),
            100.0 * machine["original"].overshoot,
            "hexapod stand-in",
        ),
        Statement(
            *("2.5", "overshoot of the original law, non-linear model", "%", "7"),
            100.0 * model["original"].overshoot,
            "",
        ),
        Statement(
            *("3.2.2", "overshoot with the integral, hardware", "%", "23"),
            100.0 * machine["velocity_integral"].overshoot,
            "hexapod stand-in",
        ),
        Statement(
            *("3.2.2", "steady-state error with the integral, hardware", "%", "below 1"),
            100.0 * abs(machine["velocity_integral"].steady_state_error),
            "hexapod stand-in",
        ),
        Statement(
            *("3.2.2", "acceleration of the oscillation with the integral", "g", "0.1"),
            _late_acceleration(runs.case("model", "velocity_integral").step),
            "largest from 1 s after the step on; the report calls 0.1 g imperceptible, published "
            "thresholds are several times lower",
        ),
        Statement(
            *("3.4", "-3 dB of position and rate feedback", "Hz", "1.08"),
            characteristics(example["rate"]).gain_bandwidth_hz,
            "our plant and gains are chosen to give it",
        ),
        Statement(
            *("3.4", "-3 dB with acceleration feedback", "Hz", "1.06"),
            characteristics(example["acceleration"]).gain_bandwidth_hz,
            "likewise",
        ),
        *_sensor_statements(runs),
        Statement(
            *("3.4.2", "peak gain of force feedback", "dB", "about 1"),
            force.bandwidths.peak_db,
            "",
        ),
        Statement(
            *("3.4.2", "acceleration of force feedback after a step", "g", "upwards of 3"),
            float(np.abs(force.step["leg_acceleration"]).max()) / units.STANDARD_GRAVITY,
            f"largest of the run, {law_title('force')} on single legs",
        ),
        Statement(
            *("4.3", "leg extension of a heave step of -1 in", "in", "0.83"),
            float(reference[-1]),
            f"geometry, {LEG.replace('_', ' ')}",
        ),
        Statement(*("4.3.1", "peak of linear model #1", "in", "0.9"), peaks[0], "Eq 4.12 closed"),
        Statement(*("4.3.2", "peak of linear model #2", "in", "0.9"), peaks[1], "Eq 4.15 closed"),
    ]
