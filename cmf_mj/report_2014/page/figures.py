"""The report's figures as ours: laws on the two plants, readings of sensors, linear models.

In chapter 4 the report's models stand with ours, made the same way from the stand-in: leg velocity
from the valve command on a pulse, a sine and the sweep of Table 2-3, by least squares (ARX).
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import control
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.signal import lfilter

from cmf_mj.analysis.identification.continuous import in_field_units
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.linear.plants import UnitTransferFunction, leg_plant
from cmf_mj.analysis.measurable import dof_history
from cmf_mj.analysis.measures import measure_loop
from cmf_mj.analysis.periodic import fit_sines
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.core.result import number
from cmf_mj.core.units import FRAME, RATE
from cmf_mj.machine.leg_motion import axial_gravity
from cmf_mj.plant.parameters import load_hydraulics
from cmf_mj.record.record import Record
from cmf_mj.report_2014.models import hardware_velocity, report_model
from cmf_mj.report_2014.page.runs import (
    FELT,
    IDENTIFIED_ON,
    REST,
    SLOW,
    Runs,
    RunSpec,
    after_step,
    leg_motion,
    leg_signals,
    report_plant,
    specs,
)
from cmf_mj.report_2014.page.tables import CONTENTS, fit_text, law_title
from cmf_mj.show import look
from cmf_mj.show.comparison import responses_figure, step_figure
from cmf_mj.studies.case import CaseResult

Array = NDArray[np.float64]

_STEP = (-0.2, 3.0)
_HARDWARE, _REPORT, _OURS = "hardware stand-in", "report's model", "our model"
_SHOWN = 1.5  # of readings of sensors [s]
_EXTENSION = "extension of leg 1 [in]"
_GRAVITY = units.STANDARD_GRAVITY

_EQUATIONS = {1: ("4.11", "4.12", "4.13"), 2: ("4.14", "4.15", "4.16"), 3: ("4.17", "4.18", "4.19")}
"""Position, velocity and acceleration of linear models 1 to 3."""

_LEG = ("position [in]", "velocity [in/s]", "acceleration [g]")

Drawing = tuple[Figure, dict[str, Any]]  #: A figure, and what its caption fills in.


class ReportFigure(NamedTuple):
    """A figure of the report, and how ours is made."""

    number: str
    title: str
    drawing: Callable[[Runs, "ReportFigure"], Drawing]
    needs: tuple[RunSpec, ...]  #: Runs it is drawn from.
    options: Mapping[str, Any] = {}  #: What one drawing function does differently in each figure.

    def cases(self, runs: Runs) -> list[CaseResult]:
        """Chirps and steps of its laws on its plants."""
        return [runs.results[need] for need in self.needs if need.signal == "case"]

    def draw(self, runs: Runs) -> tuple[Figure, str]:
        """The figure and its caption."""
        figure, values = self.drawing(runs, self)
        figure.axes[0].set_title(self.title)
        caption = CONTENTS["caption"][self.options.get("caption", self.drawing.__name__)]
        return figure, caption.format(**(CONTENTS["words"] | values))


class Line(NamedTuple):
    """A history of leg or platform in a figure."""

    name: str
    time: Array
    values: Array
    colour: str = look.BLUE
    style: str = "-"


def histories(
    panels: Mapping[str, Iterable[Line]],
    span: tuple[float, float],
    x: str = "time after the step [s]",
    height: float = 2.2,
) -> Figure:
    """Histories in axes above each other, by the label of their y axis."""
    figure, every = look.stack(8.0, height * len(panels) + 0.6, *panels, x=x)
    for axes, lines in zip(every, panels.values(), strict=True):
        for line in lines:
            seen = (line.time >= span[0]) & (line.time <= span[1])
            style: dict[str, Any] = {"color": line.colour, "linestyle": line.style}
            axes.plot(line.time[seen], line.values[seen], label=line.name, **style)
    every[-1].set_xlim(*span)
    look.legend(*every)
    return figure


def demand_and_leg(record: Record) -> tuple[Line, Line]:
    """The demand of leg 1 and what it does, positive out."""
    time = after_step(record)
    return (
        Line("demand", time, leg_motion(record, "leg_reference", "in"), look.GREY),
        Line(_HARDWARE, time, leg_motion(record, "leg_position", "in"), look.ORANGE),
    )


def coordinates(runs: Runs, figure: ReportFigure) -> Drawing:
    """A step along the degree of freedom and along a leg."""
    record = runs.record("machine", "velocity", "rise")
    demand, leg = demand_and_leg(record)
    along = [
        line._replace(values=units.from_si("in", dof_history(record, channel, "heave")))
        for line, channel in ((demand, "leg_reference"), (leg, "leg_position"))
    ]
    panels = {"heave, down [in]": along, _EXTENSION: (demand, leg)}
    return histories(panels, _STEP), {"reached": demand.values[-1]}


def responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' frequency responses in one degree of freedom; sines, where it has them, as dots."""
    drawn, dof = responses_figure(figure.cases(runs)), figure.needs[0].dof
    for need in figure.needs:
        if need.signal == "rounds":
            gain, phase = drawn.axes
            dots: dict[str, Any] = {"color": look.BLUE, "linestyle": "", "marker": "."}
            look.plot_bode(gain, phase, runs.rounds(need.law), **dots)
    size = "0.33 in" if dof in ("surge", "sway", "heave") else "0.2 deg"
    return drawn, {"axis": dof.capitalize(), "size": size, **figure.options}


def step_responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' steps in heave."""
    cases = figure.cases(runs)
    numbers = [
        f"{one.case.plant.replace('_', ' ')}: overshoot {100 * m.overshoot:.0f} %, damping ratio "
        f"{m.damping_ratio:.2f}, steady-state error {number(100 * m.steady_state_error, '.1f %')}"
        for one, m in ((one, one.measures) for one in cases)
    ]
    errors = [
        f"{one.case.law.title} {number(100 * one.measures.steady_state_error, '.2f %')}"
        for one in cases
        if one.measures.stable
    ]
    first = cases[0].measures
    return step_figure(cases), {
        **{"errors": ", ".join(errors), "numbers": "; ".join(numbers)},
        **{"overshoot": 100 * first.overshoot, "damping": first.damping_ratio},
        "error": abs(100 * first.steady_state_error),
    }


def sines(runs: Runs, figure: ReportFigure) -> Drawing:
    """Laws' motion and error in a slow sine on the single legs."""
    legs, errors = [], []
    for need, colour in zip(figure.needs, look.COLOURS, strict=False):
        record = runs.record(need.on, need.law, "sine")
        demand, leg = demand_and_leg(record)
        legs.append(leg._replace(name=law_title(need.law), colour=colour))
        errors.append(legs[-1]._replace(values=demand.values - leg.values))
    panels = {_EXTENSION: (demand, *legs), "demand less leg [in]": errors}
    return histories(panels, (3.0, 7.0), "time [s]", 3.0), {"frequency": SLOW}


def accelerometer(
    runs: Runs, figure: ReportFigure, part: tuple[float, float]
) -> tuple[Figure, Array, Array]:
    """Readings of leg accelerometers less gravity, as the DCL has them, in a part of a run [s].

    Before and behind the filter y[k+1] = a y[k] + b x[k] (Eq 3.6), which has seen the first sample
    for ever, in g, (N, 6).
    """
    (need,) = figure.needs
    law, record = load_law(need.law), runs.record(need.on, need.law, need.signal)
    a, b = law.accelerometer_pole, law.accelerometer_gain
    every = record["leg_acceleration"] / _GRAVITY
    behind, _ = lfilter([0.0, b], [1.0, -a], every, axis=0, zi=b / (1.0 - a) * every[:1])
    begin, end = (round(at * RATE) for at in part)
    raw, filtered = every[begin:end], behind[begin:end]
    time, span = FRAME * np.arange(len(raw), dtype=float), min(part[1] - part[0], _SHOWN)
    lines = [
        Line("raw", time, raw[:, 0], "#aaaaaa"),
        Line("filtered, Eq 3.6", time, filtered[:, 0], look.ORANGE),
    ]
    drawn = histories(
        {"accelerometer of leg 1\nless gravity [g]": lines}, (0.0, span), "time [s]", 3.5
    )
    return drawn, raw, filtered


def sensor_noise(runs: Runs, figure: ReportFigure) -> Drawing:
    """Accelerometers at rest, once the filter has settled."""
    drawn, raw, filtered = accelerometer(runs, figure, (0.5, REST))
    noise = [float(np.sqrt(np.mean(values.var(axis=0)))) for values in (raw, filtered)]
    gravity = float(axial_gravity(np.zeros(6)).mean()) / _GRAVITY
    return drawn, {
        "mean": gravity + float(raw.mean()),
        "gravity": gravity,
        "raw": 1e3 * noise[0],
        "filtered": 1e3 * noise[1],
        "noise": 100.0 * noise[1] / noise[0],
    }


def filter_effect(runs: Runs, figure: ReportFigure) -> Drawing:
    """Accelerometers in a sine: what the filter passes of it, and -arg H / w, its delay."""
    turn = 2.0 * np.pi * FELT
    drawn, raw, filtered = accelerometer(runs, figure, (4.0 / FELT, 9.0 / FELT))
    angle = turn * FRAME * np.arange(len(raw))
    before, after = (fit_sines(values, angle).amplitude[0].sum() for values in (raw, filtered))
    ratio = after / before
    return drawn, {
        "frequency": FELT,
        "signal": 100.0 * float(abs(ratio)),
        "delay": 1e3 * float(-np.angle(ratio) / turn),
    }


def feedback_signals(runs: Runs, figure: ReportFigure) -> Drawing:
    """Position, velocity and acceleration of a step under acceleration feedback."""
    (case,), plant = figure.cases(runs), report_plant("model")
    time, mass = after_step(case.step), float(plant.reflected_mass()[0, 0])
    # The report: acceleration from actuator force, static load and effective mass.
    computed = (case.step["leg_force"][:, 0] - plant.static_load()[0]) / mass / _GRAVITY
    signals = leg_signals(case.step)
    panels = {t: [Line("leg sensor", time, y)] for t, y in zip(_LEG, signals, strict=True)}
    panels[_LEG[2]].append(Line("(force - static load) / mass", time, computed, look.ORANGE, "--"))
    apart = float(np.abs(np.interp(time - FRAME, time, computed) - signals[2]).max())
    return histories(panels, (-0.1, 1.0)), {
        "law": case.case.law.title,
        "mass": mass / units.POUND_MASS,
        "apart": 1e3 * apart,
    }


def pressure(runs: Runs, figure: ReportFigure) -> Drawing:
    """Pressure difference of a leg under force feedback."""
    record = figure.cases(runs)[0].step
    difference = units.from_si("psi", (record["cap_pressure"] - record["rod_pressure"])[:, 0])
    line = Line(law_title("force"), after_step(record), difference)
    return histories({"cap less rod pressure [psi]": [line]}, _STEP, height=3.5), {}


# -- chapter 4 -------------------------------------------------------------------------------------


def velocity_models(runs: Runs, number: int) -> dict[str, UnitTransferFunction]:
    """The report's linear model of this number and ours: leg velocity per command [in/s per %]."""
    return {
        f"{_REPORT} #{number}": hardware_velocity(number),
        f"{_OURS} #{number}": in_field_units(runs.identified[number].continuous.rational),
    }


def driven(
    system: control.TransferFunction, command: NDArray[np.floating], step: float = FRAME
) -> Array:
    """Response from rest to a command with samples `step` seconds apart, (N,)."""
    even = np.arange(command.size) * step
    return np.asarray(control.forced_response(system, even, command).outputs)


def pulse_data(runs: Runs, figure: ReportFigure) -> Drawing:
    """What linear model 1 was fitted to."""
    time, *signals = runs.measured("pulse")
    titles = ("command [%]", *_LEG)
    panels = {t: [Line(_HARDWARE, time, y)] for t, y in zip(titles, signals, strict=True)}
    return histories(panels, (0.5, 4.0), "time [s]", 1.7), {}


def open_loops(runs: Runs, figure: ReportFigure) -> Drawing:
    """A model driven from rest at `begin` [s] by the recorded command; default `span` all of it."""
    number, begin = (figure.options[name] for name in ("number", "begin"))
    time, *signals = runs.measured(IDENTIFIED_ON[number])
    span = figure.options.get("span", (begin, float(time[-1])))
    chosen = (time >= begin) & (time <= span[1])
    time, command, *legs = (values[chosen] for values in (time, *signals))
    step = time[1] - time[0]
    _, velocity = velocity_models(runs, number).values()
    # The same model integrated and differentiated, the derivative in g.
    slope = control.tf([1.0 / units.from_si("in", _GRAVITY), 0.0], [1.0])
    plain = control.tf(velocity.num_array[0, 0], velocity.den_array[0, 0])
    ours = (plain * control.tf([1.0], [1.0, 0.0]), plain, plain * slope)
    panels, fits = {}, []
    for title, values, equation, model in zip(_LEG, legs, _EQUATIONS[number], ours, strict=True):
        theirs, our = (driven(system, command, step) for system in (report_model(equation), model))
        panels[title] = (
            Line(_HARDWARE, time, values, look.GREY),
            Line(_REPORT, time, theirs, look.ORANGE),
            Line(_OURS, time, our, look.BLUE, "--"),
        )
        fits.append(
            f"{title.split()[0]} {fit_text(values, theirs)} (Eq {equation}) and "
            f"{fit_text(values, our)} (ours)"
        )
    drawn = histories(panels, span, "time [s]")
    for axes, values in zip(drawn.axes, legs, strict=True):
        margin = 0.3 * float(np.ptp(values))
        axes.set_ylim(float(values.min()) - margin, float(values.max()) + margin)
    return drawn, {"fits": "; ".join(fits), **figure.options}


def closed_loops(runs: Runs, figure: ReportFigure) -> Drawing:
    """A step or sine with velocity feedback closed around the report's model and ours."""
    number, signal, span = (figure.options[name] for name in ("number", "signal", "span"))
    demand, leg = demand_and_leg(runs.record("machine", "velocity", signal))
    styles, models = ((look.BLUE, "-"), (look.GREEN, "--")), []
    for (name, velocity), style in zip(velocity_models(runs, number).items(), styles, strict=True):
        moved = driven(closed_loop("velocity", velocity), demand.values)
        models.append(Line(name, demand.time, moved, *style))
    inside = (demand.time > span[0]) & (demand.time < span[1])
    sizes = (
        f"{line.name.removeprefix('hardware ')} {np.ptp(line.values[inside]) / 2:.3f} in"
        for line in (leg, *models)
    )
    x = "time after the step [s]" if signal == "rise" else "time [s]"
    return histories({_EXTENSION: (demand, leg, *models)}, span, x, 3.5), {
        **figure.options,
        "numbers": "; ".join(f"{one.name} peaks at {one.values.max():.2f} in" for one in models),
        "peak": leg.values.max(),
        "sizes": "; ".join(sizes),
    }


def linear_responses(runs: Runs, figure: ReportFigure) -> Drawing:
    """Frequency responses with velocity feedback closed around models."""
    drawn, gain, phase = look.bode_axes(limits=True)
    (hardware,), lines = figure.cases(runs), np.geomspace(0.1, 10.0, 300)
    if hardware.response is not None:
        dotted: dict[str, Any] = {"color": look.GREY, "linestyle": ":"}
        look.plot_bode(gain, phase, hardware.response, label=_HARDWARE, **dotted)
    printed = {str(row.of): row for row in published_results() if row.table == "4-1"}
    for model, colour in zip(figure.options["numbers"], look.COLOURS, strict=False):
        models = velocity_models(runs, model).items()
        for (name, velocity), style in zip(models, ("-", "--"), strict=True):
            closed = loop_response(closed_loop("velocity", velocity), lines)
            look.plot_bode(gain, phase, closed, label=name, color=colour, linestyle=style)
        look.plot_printed(gain, phase, printed[f"linear_{model}"], colour)
    gain.set(ylim=(-20.0, 10.0))
    phase.set(ylim=(-270.0, 20.0), xlim=(0.1, 10.0))
    look.legend(drawn)
    return drawn, {}


def linear_model_a(runs: Runs, figure: ReportFigure) -> Drawing:
    """A step with velocity feedback closed around Eqs 4.4 to 4.6."""
    loop = closed_loop("velocity", leg_plant(*map(report_model, ("4.4", "4.5", "4.6"))))
    measures = measure_loop(loop)
    model = runs.case("model", "velocity").step
    turned_over = -leg_motion(model, "leg_position", "in")
    demand, leg = demand_and_leg(runs.record("machine", "velocity", "rise"))
    lines = (
        *(demand, leg),
        Line("non-linear model", after_step(model), turned_over, look.GREEN),
        Line("linear model A", demand.time, driven(loop, demand.values), look.BLUE, "--"),
    )
    return histories({_EXTENSION: lines}, (-0.1, 2.0), height=3.5), {
        "phase": measures.phase_bandwidth_hz,
        "gain": measures.gain_bandwidth_hz,
        "damping": measures.damping_ratio,
        "stand_in_speed": load_hydraulics("hardware").leg_speed.value,
        "model_speed": load_hydraulics("report").leg_speed.value,
    }


FIGURES = tuple(
    ReportFigure(
        *(entry["number"], entry["title"], globals()[entry["draw"]]),
        *(specs(*entry["runs"]), entry.get("options", {})),
    )
    for entry in CONTENTS["figure"]
)
"""All figures with numbers behind them, in the report's order."""
