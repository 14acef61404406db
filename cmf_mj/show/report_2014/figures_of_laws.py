"""Figures of laws on the two plants: steps, sines, frequency responses, signals of the sensors."""

from typing import cast

import numpy as np

from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.second_order import bandwidth_example, characteristics, feedback_model
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME
from cmf_mj.show.chart import GREY, Dash, Panel, curve
from cmf_mj.show.look import COLOURS
from cmf_mj.show.report_2014.contents import CONTENTS, Drawing, ReportFigure
from cmf_mj.show.report_2014.curves import (
    History,
    Response,
    after_step,
    bode,
    law_steps,
    law_title,
    motion,
    printed,
    step_history,
)
from cmf_mj.show.report_2014.runs import LEG, SLOW, On, Runs, leg_motion, plant_of
from cmf_mj.studies.accelerometer_filter import (
    AMPLITUDE,
    FREQUENCY,
    REPORTED_REST,
    FilterEffect,
    Readings,
)

PLANT_TITLES: dict[On, str] = {"machine": "hexapod", "model": "single legs"}
"""Names of the plants in legends."""

_STEP = (-0.2, 3.0)
_NON_LINEAR, _HARDWARE = "non-linear model", "hardware stand-in"
_GRAVITY = units.STANDARD_GRAVITY


def coordinates(runs: Runs, figure: ReportFigure) -> Drawing:
    """A step along the degree of freedom and along a leg."""
    record = runs.record("machine", "velocity", "rise")

    def panel(name: str, along: str, sign: float, title: str, colour: str) -> Panel:
        rows = (("demand", "leg_reference", GREY), ("response", "leg_position", colour))
        histories = [
            History(
                *(f"{what}, {name}", after_step(record)),
                *(sign * step_history(record, channel, along), shade),
            )
            for what, channel, shade in rows
        ]
        return motion(histories, title, _STEP, height=1.0)

    heave = panel("degree of freedom", "heave", 1.0, "heave, down [in]", COLOURS[0])
    leg = panel("leg", LEG, -1.0, "extension of leg 1 [in]", COLOURS[1])
    reached = -step_history(record, "leg_reference", LEG)[-1]
    return (heave, leg), {"reached": reached}


def both_responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """A law in heave on both plants."""
    (law,) = figure.laws
    responses = [
        Response(_NON_LINEAR, runs.case("model", law).response, COLOURS[0]),
        Response(f"{_HARDWARE}, chirp", runs.case("machine", law).response, COLOURS[1]),
        Response(f"{_HARDWARE}, 35 sines of Table 2-3", runs.rounds(law), COLOURS[1], marks=True),
    ]
    marks = [
        printed(law, "heave", "nonlinear", COLOURS[0], "printed, non-linear model"),
        printed(law, "heave", "hardware", COLOURS[2], "printed, hardware"),
    ]
    return bode(responses, marks), {}


def both_steps(runs: Runs, figure: ReportFigure) -> Drawing:
    """A law's step in heave on both plants."""
    (law,) = figure.laws
    demand, model = law_steps(runs, [law], "heave")
    _, machine = law_steps(runs, [law], "heave", "machine")
    both = (model._replace(name=_NON_LINEAR), machine._replace(name=_HARDWARE, colour=COLOURS[1]))
    metrics = (runs.case("model", law).measures, runs.case("machine", law).measures)
    numbers = "; ".join(
        f"{line.name}: overshoot {100 * m.overshoot:.0f} %, damping ratio {m.damping_ratio:.2f}, "
        f"steady-state error {100 * m.steady_state_error:.1f} %"
        for line, m in zip(both, metrics, strict=True)
    )
    return [motion([demand, *both], "heave [in]", _STEP)], {"numbers": numbers}


def steps(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' steps on the single legs."""
    metrics = {law_title(law): runs.case("model", law).measures for law in figure.laws}
    ringing = ", ".join(title for title, m in metrics.items() if not m.stable)
    errors = (f"{title} {100 * m.steady_state_error:.2f} %" for title, m in metrics.items())
    panel = motion(law_steps(runs, figure.laws, LEG), "retraction of leg 1 [in]", _STEP)
    note = f" Rings on undiminished: {ringing}." if ringing else ""
    return [panel], {"errors": ", ".join(errors), "note": note}


def responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' frequency responses on the single legs."""
    pairs = list(zip(figure.laws, COLOURS, strict=False))
    lines = [Response(law_title(law), runs.case("model", law).response, c) for law, c in pairs]
    return bode(lines, [printed(law, "heave", "nonlinear", c) for law, c in pairs]), {}


def sines(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' motion and error in a slow sine on the single legs."""
    records = {law: runs.record("model", law, "sine") for law in figure.laws}
    first = records[figure.laws[0]]
    histories = [History("demand", first.time, step_history(first, "leg_reference", LEG), GREY)]
    errors = []
    for (law, record), colour in zip(records.items(), COLOURS, strict=False):
        leg = History(
            law_title(law), record.time, step_history(record, "leg_position", LEG), colour
        )
        histories.append(leg)
        error = step_history(record, "leg_reference", LEG) - leg.values
        errors.append(leg._replace(values=error))
    rows = (("retraction of leg 1 [in]", histories, 1.3), ("demand less leg [in]", errors, 1.0))
    return [
        motion(lines, title, (3.0, 7.0), x_title="time [s]", height=height)
        for title, lines, height in rows
    ], {"frequency": SLOW}


def integral_step(runs: Runs, figure: ReportFigure) -> Drawing:
    """The step with and without the integral on the machine."""
    metrics = runs.case("machine", figure.laws[0]).measures
    histories = law_steps(runs, figure.laws, "heave", "machine")
    return [motion(histories, "heave [in]", _STEP)], {
        "overshoot": 100 * metrics.overshoot,
        "damping": metrics.damping_ratio,
        "error": abs(100 * metrics.steady_state_error),
    }


def simple_model(runs: Runs, figure: ReportFigure) -> Drawing:
    """Eqs 3.1 to 3.4."""
    lines = np.geomspace(0.05, 10.0, 400)
    titles = {
        "position": "position",
        "rate": "position and rate",
        "acceleration": "position, rate and acceleration",
    }
    loops = {titles[name]: loop for name, loop in bandwidth_example().items()}
    curves = [
        Response(title, loop_response(feedback_model("3.4", loop), lines), colour)
        for (title, loop), colour in zip(loops.items(), COLOURS, strict=False)
    ]
    widths = (f"{t} {characteristics(loop).gain_bandwidth_hz:.2f} Hz" for t, loop in loops.items())
    gain, phase = bode(curves, gain_range=(-40.0, 10.0), x_range=(0.05, 10.0))
    panels = gain._replace(guides=(), y_tick=10.0), phase._replace(y_range=(-185.0, 10.0))
    return panels, {"widths": "; ".join(widths)}


def _accelerometer(readings: Readings, span: float) -> Panel:
    size = round(span / FRAME)
    rows = (
        ("raw", readings.raw, "#aaaaaa", 0.8),
        ("true specific force", readings.truth, COLOURS[0], 1.5),
        ("filtered, Eq 3.6", readings.filtered, COLOURS[1], 1.5),
    )
    lines = tuple(
        curve(name, np.arange(size) * FRAME, values[:size, 0] / _GRAVITY, colour, width=width)
        for name, values, colour, width in rows
    )
    return Panel(
        "accelerometer of leg 1 [g]", lines, x_title="time [s]", x_range=(0.0, span), height=1.7
    )


def rest_noise(runs: Runs, figure: ReportFigure) -> Drawing:
    """Accelerometers at rest."""
    effect = cast("FilterEffect", runs.sensors)
    panel = _accelerometer(effect.rest, 1.0)._replace(guides=(REPORTED_REST / _GRAVITY,))
    return [panel], {
        "sensors": effect.sensors,
        "mean": effect.rest_reading / _GRAVITY,
        "gravity": effect.axial_gravity / _GRAVITY,
        "raw": 1e3 * effect.raw_rms / _GRAVITY,
        "filtered": 1e3 * effect.filtered_rms / _GRAVITY,
    }


def filter_effect(runs: Runs, figure: ReportFigure) -> Drawing:
    """Accelerometers in motion, filtered."""
    effect = cast("FilterEffect", runs.sensors)
    return [_accelerometer(effect.motion, 3.0 / FREQUENCY)], {
        "amplitude": units.from_si("in", AMPLITUDE),
        "frequency": FREQUENCY,
        "noise": 100 * effect.noise_gain,
        "signal": 100 * effect.signal_gain,
        "delay": 1e3 * effect.delay,
        "predicted": 1e3 * effect.predicted_delay,
    }


def feedback_signals(runs: Runs, figure: ReportFigure) -> Drawing:
    """Position, velocity and acceleration of a step under acceleration feedback."""
    (law,) = figure.laws
    record, plant, span = runs.case("model", law).step, plant_of("model"), (-0.1, 1.0)
    time = after_step(record)
    mass = float(plant.reflected_mass()[0, 0])
    # The report: acceleration from actuator force, static load and effective mass.
    computed = (record["leg_force"][:, 0] - plant.static_load()[0]) / mass / _GRAVITY
    acceleration = record["leg_acceleration"][:, 0] / _GRAVITY
    rows = {
        "position [in]": leg_motion(record, "leg_position", "in"),
        "velocity [in/s]": leg_motion(record, "leg_velocity", "in/s"),
        "acceleration [g]": acceleration,
    }
    histories = {t: [History("leg sensor", time, v, COLOURS[0])] for t, v in rows.items()}
    histories["acceleration [g]"].append(
        History("(force - static load) / mass", time, computed, COLOURS[1], "dash")
    )
    apart = float(np.abs(np.interp(time - FRAME, time, computed) - acceleration).max())
    return [motion(lines, title, span, height=0.8) for title, lines in histories.items()], {
        "law": law_title(law),
        "mass": mass / units.POUND_MASS,
        "apart": 1e3 * apart,
    }


def pressure(runs: Runs, figure: ReportFigure) -> Drawing:
    """Pressure difference of a leg under force feedback."""
    record = runs.case("model", "force").step
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[:, 0])
    history = History(law_title("force"), after_step(record), difference, COLOURS[4])
    return [motion([history], "cap less rod pressure [psi]", _STEP)], {}


def both_plants(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws in one degree of freedom on both plants."""
    dof = figure.needs[0].dof
    lines, marks, ringing = [], [], []
    for law, colour in zip(figure.laws, COLOURS, strict=False):
        for on, plant in PLANT_TITLES.items():
            result = runs.case(on, law, dof)
            dash: Dash = "solid" if on == "machine" else "dash"
            lines.append(Response(f"{law_title(law)}, {plant}", result.response, colour, dash))
            ringing += [lines[-1].name] * (not result.measures.stable)
        marks.append(printed(law, dof, "nonlinear", colour))
        if dof == "heave":
            marks.append(printed(law, dof, "hardware", colour, "printed, hardware"))
    circles = f" {CONTENTS['words']['circles']}" if any(map(any, marks)) else ""
    return bode(lines, marks, gain_range=(-20.0, 20.0)), {
        "axis": dof.capitalize(),
        "size": "0.33 in" if dof in ("surge", "sway", "heave") else "0.2 deg",
        "unstable": f" The step rings on undiminished: {'; '.join(ringing)}." if ringing else "",
        "marked": circles,
        **figure.options,
    }
