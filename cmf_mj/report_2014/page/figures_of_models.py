"""Figures of chapter 4: linear models and the hardware they were made from.

The report's models stand with ours, made the same way from the stand-in: leg velocity from the
valve command on a pulse, a sine and the sweep of Table 2-3, by least squares (ARX).
"""

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.identification.continuous import in_field_units
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.linear.plants import UnitTransferFunction, leg_plant
from cmf_mj.analysis.measures import measure_loop
from cmf_mj.core import units
from cmf_mj.core.units import FRAME
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.record.record import Record
from cmf_mj.report_2014.models import hardware_velocity, report_model
from cmf_mj.report_2014.page.curves import (
    Drawing,
    ReportFigure,
    after_step,
    bode,
    motion,
    printed,
    response,
)
from cmf_mj.report_2014.page.runs import IDENTIFIED_ON, Runs, Signal, leg_motion
from cmf_mj.show.look import COLOURS, GREY, Curve, Dash

_EQUATIONS = {1: ("4.11", "4.12", "4.13"), 2: ("4.14", "4.15", "4.16"), 3: ("4.17", "4.18", "4.19")}
"""Position, velocity and acceleration of linear models 1 to 3."""

_SIGNAL_TITLES = {
    1: "a pulse of 1 in",
    2: "a sine of 1 in at 1 Hz",
    3: "the five rounds of Table 2-3, end to end",
}
_DASHES: tuple[Dash, Dash] = ("solid", "dash")
"""Of the report's model and of ours."""

_HARDWARE, _REPORT, _OURS = "hardware stand-in", "report's model", "our model"
_EXTENSION = "extension of leg 1 [in]"
_LEG = ("position [in]", "velocity [in/s]", "acceleration [g]")


def _velocities(runs: Runs, number: int) -> dict[str, UnitTransferFunction]:
    return {
        f"{_REPORT} #{number}": hardware_velocity(number),
        f"{_OURS} #{number}": in_field_units(runs.identified[number].continuous.rational),
    }


def _driven(
    system: control.TransferFunction, command: NDArray[np.floating], step: float = FRAME
) -> NDArray[np.float64]:
    """Response from rest to a command with samples `step` seconds apart, (N,)."""
    even = np.arange(command.size) * step
    return np.asarray(control.forced_response(system, even, command).outputs)


def _measured(runs: Runs, signal: Signal) -> tuple[NDArray[np.float64], ...]:
    """Time, command less its mean [%], position [in], velocity [in/s], acceleration [g].

    The five rounds of the sweep are put end to end, as section 4.3.3 says.
    """
    records = runs.records("machine", "velocity", signal)
    begins = np.cumsum([0.0, *(record.time.size / record.rate for record in records[:-1])])
    time = [r.time - r.time[0] + begin for r, begin in zip(records, begins, strict=True)]
    command = np.concatenate([record["valve_command"][:, 0] for record in records])
    return (
        np.concatenate(time),
        100.0 * (command - command.mean()),
        *(
            np.concatenate([leg_motion(record, channel, unit) for record in records])
            for channel, unit in (("leg_position", "in"), ("leg_velocity", "in/s"))
        ),
        np.concatenate([r["leg_acceleration"][:, 0] for r in records]) / units.STANDARD_GRAVITY,
    )


def _demand_and_leg(record: Record) -> tuple[Curve, Curve]:
    time = after_step(record)
    return (
        Curve("demand", time, leg_motion(record, "leg_reference", "in"), GREY),
        Curve(_HARDWARE, time, leg_motion(record, "leg_position", "in"), COLOURS[1]),
    )


def pulse_data(runs: Runs, figure: ReportFigure) -> Drawing:
    """What linear model 1 was fitted to."""
    time, *histories = _measured(runs, "pulse")
    return [
        motion(title, [Curve(_HARDWARE, time, y, COLOURS[1])], (0.5, 4.0), "time [s]", 0.7)
        for title, y in zip(("command [%]", *_LEG), histories, strict=True)
    ], {}


def _fit(measured: NDArray[np.float64], modelled: NDArray[np.float64]) -> str:
    """100 (1 - |y - yhat| / |y - mean y|) %; what has less than nothing in common has no fit."""
    apart, spread = measured - modelled, measured - measured.mean()
    fit = float(100.0 * (1.0 - np.linalg.norm(apart) / np.linalg.norm(spread)))
    return f"{fit:.0f} %" if fit > -100.0 else "no fit"


def open_loop(runs: Runs, figure: ReportFigure) -> Drawing:
    """A model driven from rest at `begin` [s] by the recorded command; default `span` all of it."""
    number, begin = (figure.options[name] for name in ("number", "begin"))
    time, *histories = _measured(runs, IDENTIFIED_ON[number])
    span = figure.options.get("span", (begin, float(time[-1])))
    driven = (time >= begin) & (time <= span[1])
    time, command, *measured = (values[driven] for values in (time, *histories))
    step = time[1] - time[0]
    _, velocity = _velocities(runs, number).values()
    # The same model integrated and differentiated, the derivative in g.
    slope = control.tf([1.0 / units.from_si("in", units.STANDARD_GRAVITY), 0.0], [1.0])
    plain = control.tf(velocity.num_array[0, 0], velocity.den_array[0, 0])
    ours = (plain * control.tf([1.0], [1.0, 0.0]), plain, plain * slope)
    panels, fits = [], []
    for title, values, equation, model in zip(
        _LEG, measured, _EQUATIONS[number], ours, strict=True
    ):
        theirs, our = (_driven(system, command, step) for system in (report_model(equation), model))
        curves = (
            Curve(_HARDWARE, time, values, GREY),
            Curve(_REPORT, time, theirs, COLOURS[1]),
            Curve(_OURS, time, our, COLOURS[0], "dash"),
        )
        margin = 0.3 * float(np.ptp(values))
        limits = (float(values.min()) - margin, float(values.max()) + margin)
        panels.append(motion(title, curves, span, "time [s]", 0.9)._replace(y_range=limits))
        fits.append(
            f"{title.split()[0]} {_fit(values, theirs)} (Eq {equation}) and "
            f"{_fit(values, our)} (ours)"
        )
    return panels, {
        **{"number": number, "begin": begin, "signal": _SIGNAL_TITLES[number]},
        "fits": "; ".join(fits),
    }


def closed_loops(runs: Runs, figure: ReportFigure) -> Drawing:
    """A step or sine with velocity feedback closed around the report's model and ours."""
    number, signal, span = (figure.options[name] for name in ("number", "signal", "span"))
    demand, leg = _demand_and_leg(runs.record("machine", "velocity", signal))
    models = [
        Curve(name, demand.x, _driven(closed_loop("velocity", velocity), demand.y), colour, dash)
        for (name, velocity), colour, dash in zip(
            _velocities(runs, number).items(), (COLOURS[0], COLOURS[2]), _DASHES, strict=True
        )
    ]
    inside = (demand.x > span[0]) & (demand.x < span[1])
    sizes = (
        f"{line.name.removeprefix('hardware ')} {np.ptp(line.y[inside]) / 2:.3f} in"
        for line in (leg, *models)
    )
    x_title = "time after the step [s]" if signal == "rise" else "time [s]"
    return [motion(_EXTENSION, (demand, leg, *models), span, x_title)], {
        "number": number,
        "numbers": "; ".join(f"{line.name} peaks at {line.y.max():.2f} in" for line in models),
        "peak": leg.y.max(),
        "sizes": "; ".join(sizes),
    }


def linear_responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """Frequency responses with velocity feedback closed around models."""
    frequencies = np.geomspace(0.1, 10.0, 300)
    lines = [response(_HARDWARE, runs.case("machine", "velocity").response, GREY, "dot")]
    marks = []
    for number, colour in zip(figure.options["numbers"], COLOURS, strict=False):
        for (name, velocity), dash in zip(_velocities(runs, number).items(), _DASHES, strict=True):
            closed = loop_response(closed_loop("velocity", velocity), frequencies)
            lines.append(response(name, closed, colour, dash))
        marks.append(printed("velocity", "heave", f"linear_{number}", colour, table="4-1"))
    return bode([*lines, *marks], (-20.0, 10.0)), {}


def linear_model_a(runs: Runs, figure: ReportFigure) -> Drawing:
    """A step with velocity feedback closed around Eqs 4.4 to 4.6."""
    loop = closed_loop("velocity", leg_plant(*map(report_model, ("4.4", "4.5", "4.6"))))
    measures = measure_loop(loop)
    model = runs.case("model", "velocity").step
    demand, leg = _demand_and_leg(runs.record("machine", "velocity", "rise"))
    turned_over = -leg_motion(model, "leg_position", "in")
    curves = [
        *(demand, leg, Curve("non-linear model", after_step(model), turned_over, COLOURS[2])),
        Curve("linear model A", demand.x, _driven(loop, demand.y), COLOURS[0], "dash"),
    ]
    return [motion(_EXTENSION, curves, (-0.1, 2.0))], {
        "phase": measures.phase_bandwidth_hz,
        "gain": measures.gain_bandwidth_hz,
        "damping": measures.damping_ratio,
        "stand_in_speed": load_hydraulics("hardware").leg_speed.value,
        "model_speed": load_hydraulics("report").leg_speed.value,
    }
