"""Figures of laws on the two plants: steps, sines, frequency responses, signals of the sensors."""

from typing import cast

import numpy as np

from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.core import units
from cmf_mj.core.units import FRAME
from cmf_mj.report_2014.accelerometer_filter import AMPLITUDE, FREQUENCY, FilterEffect, Readings
from cmf_mj.report_2014.page.curves import (
    Drawing,
    ReportFigure,
    after_step,
    bode,
    case_response,
    law_histories,
    law_steps,
    law_title,
    motion,
    printed,
    response,
    step_history,
)
from cmf_mj.report_2014.page.runs import LEG, SLOW, On, Runs, leg_motion, plant_of
from cmf_mj.report_2014.second_order import bandwidth_example, characteristics, feedback_model
from cmf_mj.show.look import COLOURS, GREY, Curve, Dash

_PLANTS: tuple[tuple[On, str, Dash], ...] = (
    ("machine", "hexapod", "solid"),
    ("model", "single legs", "dash"),
)
_STEP = (-0.2, 3.0)
_NON_LINEAR, _HARDWARE = "non-linear model", "hardware stand-in"
_GRAVITY = units.STANDARD_GRAVITY


def coordinates(runs: Runs, figure: ReportFigure) -> Drawing:
    """A step along the degree of freedom and along a leg."""
    record, panels = runs.record("machine", "velocity", "rise"), []
    for name, along, sign, title, colour in (
        ("degree of freedom", "heave", 1.0, "heave, down [in]", COLOURS[0]),
        ("leg", LEG, -1.0, "extension of leg 1 [in]", COLOURS[1]),
    ):
        demand, response = (
            sign * step_history(record, channel, along)
            for channel in ("leg_reference", "leg_position")
        )
        time = after_step(record)
        curves = (
            Curve(f"demand, {name}", time, demand, GREY),
            Curve(f"response, {name}", time, response, colour),
        )
        panels.append(motion(title, curves, _STEP, height=1.0))
    return panels, {"reached": demand[-1]}


def both_responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """A law in heave on both plants."""
    (law,) = figure.laws
    model, machine = (runs.case(on, law).response for on in ("model", "machine"))
    rounds = f"{_HARDWARE}, 35 sines of Table 2-3"
    pairs = [
        response(_NON_LINEAR, model, COLOURS[0]),
        response(f"{_HARDWARE}, chirp", machine, COLOURS[1]),
        response(rounds, runs.rounds(law), COLOURS[1], marks="dot"),
        printed(law, "heave", "nonlinear", COLOURS[0], "printed, non-linear model"),
        printed(law, "heave", "hardware", COLOURS[2], "printed, hardware"),
    ]
    return bode(pairs), {}


def both_steps(runs: Runs, figure: ReportFigure) -> Drawing:
    """A law's step in heave on both plants."""
    (law,) = figure.laws
    demand, model = law_steps(runs, [law], "heave")
    _, machine = law_steps(runs, [law], "heave", "machine")
    both = (model._replace(name=_NON_LINEAR), machine._replace(name=_HARDWARE, colour=COLOURS[1]))
    metrics = (runs.case(on, law).measures for on in ("model", "machine"))
    numbers = "; ".join(
        f"{line.name}: overshoot {100 * m.overshoot:.0f} %, damping ratio {m.damping_ratio:.2f}, "
        f"steady-state error {100 * m.steady_state_error:.1f} %"
        for line, m in zip(both, metrics, strict=True)
    )
    return [motion("heave [in]", (demand, *both), _STEP)], {"numbers": numbers}


def steps(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' steps on one plant."""
    on, along = figure.options.get("on", "model"), figure.options.get("along", LEG)
    metrics = {law_title(law): runs.case(on, law).measures for law in figure.laws}
    first, *_ = metrics.values()
    errors = (
        f"{title} {100 * m.steady_state_error:.2f} %" for title, m in metrics.items() if m.stable
    )
    title = "retraction of leg 1 [in]" if along == LEG else f"{along} [in]"
    return [motion(title, law_steps(runs, figure.laws, along, on), _STEP)], {
        "errors": ", ".join(errors),
        "overshoot": 100 * first.overshoot,
        "damping": first.damping_ratio,
        "error": abs(100 * first.steady_state_error),
    }


def responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' frequency responses on the single legs."""
    laws = list(zip(figure.laws, COLOURS, strict=False))
    lines = [case_response(runs.case("model", law), c) for law, c in laws]
    return bode([*lines, *(printed(law, "heave", "nonlinear", c) for law, c in laws)]), {}


def sines(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' motion and error in a slow sine on the single legs."""
    records = [runs.record("model", law, "sine") for law in figure.laws]
    demand, *legs = law_histories(records, [*map(law_title, figure.laws)], LEG)
    errors = [
        leg._replace(y=step_history(record, "leg_reference", LEG) - leg.y)
        for leg, record in zip(legs, records, strict=True)
    ]
    span = (3.0, 7.0)
    return [
        motion("retraction of leg 1 [in]", (demand, *legs), span, height=1.3),
        motion("demand less leg [in]", errors, span, "time [s]", 1.0),
    ], {"frequency": SLOW}


def simple_model(runs: Runs, figure: ReportFigure) -> Drawing:
    """Eqs 3.1 to 3.4."""
    lines = np.geomspace(0.05, 10.0, 400)
    titles = ("position", "position and rate", "position, rate and acceleration")
    loops = dict(zip(titles, bandwidth_example().values(), strict=True))
    pairs = [
        response(title, loop_response(feedback_model("3.4", loop), lines), colour)
        for (title, loop), colour in zip(loops.items(), COLOURS, strict=False)
    ]
    widths = (f"{t} {characteristics(loop).gain_bandwidth_hz:.2f} Hz" for t, loop in loops.items())
    gain, phase = bode(pairs, (-40.0, 10.0), (0.05, 10.0))
    panels = gain._replace(guides=(), y_tick=10.0), phase._replace(y_range=(-185.0, 10.0))
    return panels, {"widths": "; ".join(widths)}


def accelerometer(runs: Runs, figure: ReportFigure) -> Drawing:
    """Accelerometer of a leg at rest or in motion, before and behind the filter."""
    effect, span = cast("FilterEffect", runs.sensors), figure.options["span"]
    readings: Readings = getattr(effect, figure.options["state"])
    size = round(span / FRAME)
    curves = [
        Curve(name, np.arange(size) * FRAME, values[:size, 0] / _GRAVITY, colour, width=width)
        for name, values, colour, width in (
            ("raw", readings.raw, "#aaaaaa", 0.8),
            ("true specific force", readings.truth, COLOURS[0], 1.5),
            ("filtered, Eq 3.6", readings.filtered, COLOURS[1], 1.5),
        )
    ]
    panel = motion("accelerometer of leg 1 [g]", curves, (0.0, span), "time [s]")
    return [panel._replace(guides=figure.options.get("guides", ()))], {
        "sensors": effect.sensors,
        "mean": effect.rest_reading / _GRAVITY,
        "gravity": effect.axial_gravity / _GRAVITY,
        "raw": 1e3 * effect.raw_rms / _GRAVITY,
        "filtered": 1e3 * effect.filtered_rms / _GRAVITY,
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
    record, plant = runs.case("model", law).step, plant_of("model")
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
    curves = {title: [Curve("leg sensor", time, y, COLOURS[0])] for title, y in rows.items()}
    name = "(force - static load) / mass"
    curves["acceleration [g]"].append(Curve(name, time, computed, COLOURS[1], "dash"))
    apart = float(np.abs(np.interp(time - FRAME, time, computed) - acceleration).max())
    return [motion(title, lines, (-0.1, 1.0), height=0.8) for title, lines in curves.items()], {
        "law": law_title(law),
        "mass": mass / units.POUND_MASS,
        "apart": 1e3 * apart,
    }


def pressure(runs: Runs, figure: ReportFigure) -> Drawing:
    """Pressure difference of a leg under force feedback."""
    record = runs.case("model", "force").step
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[:, 0])
    history = Curve(law_title("force"), after_step(record), difference, COLOURS[4])
    return [motion("cap less rod pressure [psi]", [history], _STEP)], {}


def both_plants(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws in one degree of freedom on both plants."""
    dof = figure.needs[0].dof
    lines, marks = [], []
    for law, colour in zip(figure.laws, COLOURS, strict=False):
        for on, plant, dash in _PLANTS:
            lines.append(case_response(runs.case(on, law, dof), colour, dash, plant))
        marks.append(printed(law, dof, "nonlinear", colour))
        if dof == "heave":
            marks.append(printed(law, dof, "hardware", colour, "printed, hardware"))
    return bode([*lines, *marks], (-20.0, 20.0)), {
        "axis": dof.capitalize(),
        "size": "0.33 in" if dof in ("surge", "sway", "heave") else "0.2 deg",
        **figure.options,
    }
