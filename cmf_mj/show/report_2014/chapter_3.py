"""Figures of chapter 3: integral, rate, acceleration and force feedback."""

from collections.abc import Sequence

import numpy as np

from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.second_order import (
    bandwidth_example,
    characteristics,
    feedback_model,
)
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.show.report_2014.chart import COLOURS, GREY, Chart, Panel, curve
from cmf_mj.show.report_2014.curves import (
    CIRCLES,
    MODEL,
    STAND_IN,
    History,
    ReportFigure,
    Response,
    after_step,
    bode,
    cases,
    law_responses,
    law_steps,
    law_title,
    motion,
    printed,
    step_history,
)
from cmf_mj.show.report_2014.runs import LEG, SLOW, Runs, Wanted, hydraulics_of
from cmf_mj.studies.accelerometer_filter import AMPLITUDE, FREQUENCY, REPORTED_REST, Readings

RATES = ("original", "velocity", "position_error_rate", "velocity_error", "combined_rate")
"""Laws of Figures 3-9 to 3-11."""

GENERAL = ("original", "velocity", "position_error_rate", "acceleration", "force")
"""Laws of Figures 3-20 to 3-23."""

_INTEGRAL = ("velocity", "velocity_integral", "original")
_STEP = (-0.2, 3.0)


def _steps(laws: Sequence[str], runs: Runs) -> Chart:
    ringing = [law_title(law) for law in laws if not runs.case("model", law).metrics.stable]
    note = f" Rings on undiminished: {', '.join(ringing)}." if ringing else ""
    errors = ", ".join(
        f"{law_title(law)} {100 * runs.case('model', law).metrics.steady_state_error:.2f} %"
        for law in laws
    )
    return Chart(
        (motion(law_steps(runs, laws, LEG), "retraction of leg 1 [in]", _STEP),),
        f"Heave step of 1 in, down: each leg retracts 0.832 in. Steady-state errors: {errors}."
        f"{note} {MODEL}",
    )


def _responses(laws: Sequence[str], runs: Runs) -> Chart:
    responses = law_responses(runs, laws)
    marks = [
        printed(law, "heave", "nonlinear", colour)
        for law, colour in zip(laws, COLOURS, strict=False)
    ]
    return Chart(bode(responses, marks), f"Heave, 0.33 in chirp. {MODEL} {CIRCLES}")


def _sines(laws: Sequence[str], runs: Runs) -> Chart:
    span = (3.0, 7.0)
    first = runs.record("model", laws[0], "sine")
    histories = [History("demand", first.time, step_history(first, "leg_reference", LEG), GREY)]
    errors = []
    for law, colour in zip(laws, COLOURS, strict=False):
        record = runs.record("model", law, "sine")
        values = step_history(record, "leg_position", LEG)
        histories.append(History(law_title(law), record.time, values, colour))
        errors.append(
            History(
                law_title(law),
                record.time,
                step_history(record, "leg_reference", LEG) - values,
                colour,
            )
        )
    return Chart(
        (
            motion(histories, "retraction of leg 1 [in]", span, x_title="", height=1.3),
            motion(errors, "demand less leg [in]", span, x_title="time [s]", height=1.0),
        ),
        f"Heave, 1 in at {SLOW:g} Hz; the two middle cycles. {MODEL}",
    )


def _integral_on_machine(runs: Runs) -> Chart:
    result = runs.case("machine", "velocity_integral")
    histories = law_steps(runs, ("velocity_integral", "velocity"), "heave", "machine")
    return Chart(
        (motion(histories, "heave [in]", _STEP),),
        f"Heave step of 1 in with velocity, position and integral feedback: overshoot "
        f"{100 * result.metrics.overshoot:.0f} %, damping ratio "
        f"{result.metrics.damping_ratio:.2f}, "
        f"steady-state error {abs(100 * result.metrics.steady_state_error):.2f} % (printed: 23 "
        "%, about "
        f"0.4, below 1 %). Without the integral the law stops short by its DC gain of 47/50.48. "
        f"{STAND_IN}",
    )


def _simple_model(runs: Runs) -> Chart:
    lines = np.geomspace(0.05, 10.0, 400)
    titles = {
        "position": "position",
        "rate": "position and rate",
        "acceleration": "position, rate and acceleration",
    }
    responses, widths = [], []
    for (name, loop), colour in zip(bandwidth_example().items(), COLOURS, strict=False):
        response = loop_response(feedback_model("3.4", loop), lines)
        responses.append(Response(titles[name], response, colour))
        widths.append(f"{titles[name]} {characteristics(loop).gain_bandwidth_hz:.2f} Hz")
    gain, phase = bode(responses, gain_range=(-40.0, 10.0), x_range=(0.05, 10.0))
    return Chart(
        (
            gain._replace(guides=(), y_tick=10.0),
            phase._replace(y_range=(-185.0, 10.0)),
        ),
        f"Eqs 3.1 to 3.4 with K_p = 1; -3 dB from the static gain: {'; '.join(widths)}. The report "
        "prints 1.08 Hz for position and rate, 1.06 Hz with acceleration, and neither plant nor "
        "gains: ours are chosen to give these two numbers (plant damping 0.1, loop damping 0.7, "
        "assumed).",
    )


def _accelerometer(readings: Readings, span: float, *, rest: bool) -> Panel:
    size = round(span / FRAME)
    time = np.arange(size) * FRAME
    gravity = units.STANDARD_GRAVITY
    lines = [
        curve("raw", time, readings.raw[:size, 0] / gravity, "#aaaaaa", width=0.8),
        curve("true specific force", time, readings.truth[:size, 0] / gravity, COLOURS[0]),
        curve("filtered, Eq 3.6", time, readings.filtered[:size, 0] / gravity, COLOURS[1]),
    ]
    level = (REPORTED_REST / gravity,) if rest else ()
    return Panel(
        "accelerometer of leg 1 [g]",
        tuple(lines),
        guides=level,
        x_title="time [s]",
        x_range=(0.0, span),
        height=1.7,
    )


def _at_rest(runs: Runs) -> Chart:
    effect = runs.sensors
    assert effect is not None
    gravity = units.STANDARD_GRAVITY
    return Chart(
        (_accelerometer(effect.rest, 1.0, rest=True),),
        f"Leg accelerometer at rest with the {effect.sensors} sensor set: mean "
        f"{effect.rest_reading / gravity:.3f} g, of which {effect.axial_gravity / gravity:.3f} "
        "g is "
        f"gravity along the leg (Appendix C); the hardware read 0.86 g (dotted). Noise "
        f"{1e3 * effect.raw_rms / gravity:.1f} mg rms, filtered "
        f"{1e3 * effect.filtered_rms / gravity:.2f} mg. {STAND_IN}",
    )


def _filtered(runs: Runs) -> Chart:
    effect = runs.sensors
    assert effect is not None
    return Chart(
        (_accelerometer(effect.motion, 3.0 / FREQUENCY, rest=False),),
        f"Heave of {units.from_si('in', AMPLITUDE):.2f} in at {FREQUENCY} Hz: the filter of Eq 3.6 "
        f"leaves {100 * effect.noise_gain:.1f} % of white noise, passes "
        f"{100 * effect.signal_gain:.1f} % of the motion and delays it by "
        f"{1e3 * effect.delay:.0f} ms (closed form {1e3 * effect.predicted_delay:.0f} ms). The "
        "text "
        f"says about 10 ms, which Eq 3.6 has nowhere below 3 Hz. {STAND_IN}",
    )


def _signals(runs: Runs) -> Chart:
    record = runs.case("model", "acceleration").step
    time = after_step(record)
    plant = SingleLegs(hydraulics_of("model"))
    mass = float(plant.reflected_mass()[0, 0])
    gravity = units.STANDARD_GRAVITY
    force = record["leg_force"][:, 0]
    # The report: acceleration from actuator force, static load and effective mass.
    computed = (force - plant.static_load()[0]) / mass / gravity
    span = (-0.1, 1.0)
    rows = (
        ("position [in]", units.from_si("in", record["leg_position"][:, 0])),
        ("velocity [in/s]", units.from_si("in/s", record["leg_velocity"][:, 0])),
        ("acceleration [g]", record["leg_acceleration"][:, 0] / gravity),
    )
    panels = [
        motion(
            [History("leg sensor", time, values, COLOURS[0])], title, span, x_title="", height=0.8
        )
        for title, values in rows
    ]
    both = (
        *panels[2].curves,
        curve("(force - static load) / mass", time, computed, COLOURS[1], "dash", within=span),
    )
    panels[2] = panels[2]._replace(curves=both, x_title="time after the step [s]")
    late = np.interp(time - FRAME, time, computed)
    apart = float(np.abs(late - rows[2][1]).max())
    return Chart(
        tuple(panels),
        f"The three feedback signals of a heave step of 1 in under {law_title('acceleration')}, "
        f"extension of leg 1. The acceleration is force less static load over the effective mass "
        f"of {mass / units.POUND_MASS:.0f} lbm, as in the report's model; computed so from the "
        f"recorded force it differs by {1e3 * apart:.1f} mg at most from the sensor, which reads "
        f"the step before. {MODEL}",
    )


def _pressure(runs: Runs) -> Chart:
    record = runs.case("model", "force").step
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[:, 0])
    panel = motion(
        [History(load_law("force").title, after_step(record), difference, COLOURS[4])],
        "cap less rod pressure [psi]",
        (-0.2, 3.0),
    )
    return Chart(
        (panel,),
        "Pressure difference under force feedback, the step of Figure 3-20. The oscillation "
        "and its "
        f"frequency are examined in the section on force feedback. {MODEL}",
    )


def _sine_runs(laws: Sequence[str]) -> tuple[Wanted, ...]:
    return tuple(Wanted("model", law, "heave", "sine") for law in laws)


FIGURES = (
    ReportFigure(
        "3-2",
        "Velocity feedback with and without the integral, and the original law, step",
        cases("model", _INTEGRAL),
        lambda runs: _steps(_INTEGRAL, runs),
    ),
    ReportFigure(
        "3-3",
        "Velocity feedback with and without the integral, frequency response",
        cases("model", _INTEGRAL[:2]),
        lambda runs: _responses(_INTEGRAL[:2], runs),
    ),
    ReportFigure(
        "3-4",
        "Velocity, position and error integral feedback on the hardware, step",
        cases("machine", ("velocity_integral", "velocity")),
        _integral_on_machine,
    ),
    ReportFigure(
        "3-9",
        "Rate feedback techniques, step of 1 in",
        cases("model", RATES),
        lambda runs: _steps(RATES, runs),
    ),
    ReportFigure(
        "3-10",
        "Rate feedback techniques, 1 in at 0.5 Hz",
        _sine_runs(RATES),
        lambda runs: _sines(RATES, runs),
    ),
    ReportFigure(
        "3-11",
        "Rate feedback techniques, frequency response",
        cases("model", RATES),
        lambda runs: _responses(RATES, runs),
    ),
    ReportFigure("3-14", "Bode diagram of a simple linear model", (), _simple_model),
    ReportFigure("3-15", "Noise of the acceleration sensors at rest", (), _at_rest, True),
    ReportFigure("3-16", "Effect of the accelerometer filter", (), _filtered, True),
    ReportFigure(
        "3-17",
        "Acceleration, velocity and position as the model computes them",
        cases("model", ("acceleration",)),
        _signals,
    ),
    ReportFigure(
        "3-20",
        "Compensators compared, step of 1 in",
        cases("model", GENERAL),
        lambda runs: _steps(GENERAL, runs),
    ),
    ReportFigure(
        "3-21", "Pressure difference under force feedback", cases("model", ("force",)), _pressure
    ),
    ReportFigure(
        "3-22",
        "Compensators compared, 1 in at 0.5 Hz",
        _sine_runs(GENERAL),
        lambda runs: _sines(GENERAL, runs),
    ),
    ReportFigure(
        "3-23",
        "Compensators compared, frequency response",
        cases("model", GENERAL),
        lambda runs: _responses(GENERAL, runs),
    ),
)
