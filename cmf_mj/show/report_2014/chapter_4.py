"""Figures of chapter 4: linear models beside the hardware they were made from.

The report's models stand beside our own, made the same way from the stand-in: leg velocity from the
valve command on a pulse, a sine and the sweep of Table 2-3, by least squares (ARX).
"""

from collections.abc import Callable
from functools import partial
from typing import cast

import control
import numpy as np
from numpy.typing import NDArray

from cmf_mj.analysis.identification.continuous import in_field_units
from cmf_mj.analysis.linear.catalogue import hardware_velocity, report_model
from cmf_mj.analysis.linear.loop import closed_loop, loop_response
from cmf_mj.analysis.linear.plants import leg_plant
from cmf_mj.analysis.linear.transfer import UnitTransferFunction
from cmf_mj.analysis.measures import measure_loop
from cmf_mj.core import units
from cmf_mj.core.rates import FRAME
from cmf_mj.record.record import Record
from cmf_mj.show.report_2014.chart import COLOURS, GREY, Chart, Dash
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
    motion,
    printed,
)
from cmf_mj.show.report_2014.runs import (
    IDENTIFIED_ON,
    ORDERS,
    STEP,
    Runs,
    Signal,
    Wanted,
    leg_motion,
)

_LINES = np.geomspace(0.1, 10.0, 300)
_EQUATIONS = {1: ("4.11", "4.12", "4.13"), 2: ("4.14", "4.15", "4.16"), 3: ("4.17", "4.18", "4.19")}
"""Position, velocity and acceleration of linear models 1 to 3."""

_SIGNAL_TITLES = {
    1: "a pulse of 1 in",
    2: f"a sine of {units.from_si('in', STEP):g} in at 1 Hz",
    3: "the third round of Table 2-3, 3.4 to 5.4 Hz",
}
_OWN = (
    f"Ours: ARX of orders {tuple(ORDERS)} at 64 Hz on the stand-in's runs, position by integration "
    "(docs/identification.md)."
)
_DASHES: tuple[Dash, Dash] = ("solid", "dash")
"""Of the report's model and of ours."""

_HARDWARE, _REPORT, _OURS = "hardware stand-in", "report's model", "our model"


def _own_velocity(runs: Runs, number: int) -> UnitTransferFunction:
    return in_field_units(runs.identified[number].continuous.rational)


def _velocities(runs: Runs, number: int) -> tuple[tuple[str, UnitTransferFunction], ...]:
    return (
        (f"{_REPORT} #{number}", hardware_velocity(number)),
        (f"{_OURS} #{number}", _own_velocity(runs, number)),
    )


def _driven(
    system: control.TransferFunction, command: NDArray[np.float64], time: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Open-loop response to a command from rest, (N,)."""
    even = np.arange(time.size) * (time[1] - time[0])
    return np.asarray(control.forced_response(system, even, command).outputs)


def _measured(runs: Runs, signal: Signal) -> tuple[NDArray[np.float64], ...]:
    """Time, command less its mean [%], position [in], velocity [in/s], acceleration [g].

    Of the sweep its third round, 3.4 to 5.4 Hz, the band chapter 4 aims at.
    """
    kept = runs.results[Wanted("machine", "velocity", "heave", signal)]
    record: Record = kept[2] if signal == "rounds" else kept
    return (
        record.time - record.time[0],
        100.0 * (record["valve_command"][:, 0] - record["valve_command"][:, 0].mean()),
        leg_motion(record, "leg_position", "in"),
        leg_motion(record, "leg_velocity", "in/s"),
        record["leg_acceleration"][:, 0] / units.STANDARD_GRAVITY,
    )


def _fit(measured: NDArray[np.float64], modelled: NDArray[np.float64]) -> float:
    """100 (1 - |y - yhat| / |y - mean y|) [%]."""
    return float(
        100.0
        * (1.0 - np.linalg.norm(measured - modelled) / np.linalg.norm(measured - measured.mean()))
    )


def _pulse_data(runs: Runs) -> Chart:
    time, command, position, velocity, acceleration = _measured(runs, "pulse")
    span = (0.5, 4.0)
    rows = (
        ("command [%]", command),
        ("position [in]", position),
        ("velocity [in/s]", velocity),
        ("acceleration [g]", acceleration),
    )
    panels = tuple(
        motion(
            [History(_HARDWARE, time, values, COLOURS[1])],
            title,
            span,
            x_title="time [s]" if title.startswith("acc") else "",
            height=0.7,
        )
        for title, values in rows
    )
    return Chart(panels, f"Leg 1 in a heave pulse of 1 in, 1 s long, down; velocity FB. {STAND_IN}")


def _fit_text(fit: float) -> str:
    """In per cent; what has less than nothing in common has left the figure."""
    return f"{fit:.0f} %" if fit > -100.0 else "no fit"


def _open_loop(number: int, begin: float, span: tuple[float, float], runs: Runs) -> Chart:
    """A model driven from rest at `begin` [s] by the recorded command."""
    time, command, *measured = _measured(runs, cast("Signal", IDENTIFIED_ON[number]))
    driven = (time >= begin) & (time <= span[1])
    time, command = time[driven], command[driven]
    own = _own_velocity(runs, number)
    # The same model integrated and differentiated, the derivative in g.
    slope = control.tf([1.0 / units.from_si("in", units.STANDARD_GRAVITY), 0.0], [1.0])
    plain = control.tf(own.num_array[0, 0], own.den_array[0, 0])
    ours = (plain * control.tf([1.0], [1.0, 0.0]), plain, plain * slope)
    titles = ("position [in]", "velocity [in/s]", "acceleration [g]")
    panels, fits = [], []
    for title, whole, equation, mine in zip(
        titles, measured, _EQUATIONS[number], ours, strict=True
    ):
        values = whole[driven]
        theirs = _driven(report_model(equation), command, time)
        fitted = _driven(mine, command, time)
        room = 0.3 * float(np.ptp(values))
        panels.append(
            motion(
                [
                    History(_HARDWARE, time, values, GREY),
                    History(_REPORT, time, theirs, COLOURS[1]),
                    History(_OURS, time, fitted, COLOURS[0], "dash"),
                ],
                title,
                span,
                x_title="time [s]" if title == titles[-1] else "",
                y_range=(float(values.min()) - room, float(values.max()) + room),
                height=0.9,
            )
        )
        fits.append(
            f"{title.split()[0]} {_fit_text(_fit(values, theirs))} (Eq {equation}) and "
            f"{_fit_text(_fit(values, fitted))} (ours)"
        )
    return Chart(
        tuple(panels),
        f"The stand-in's leg 1 under {_SIGNAL_TITLES[number]}, velocity FB, and linear models "
        f"#{number} driven open loop by its valve command from {begin:g} s on. Fit from there: "
        f"{'; '.join(fits)}. The report's models were fitted to the real machine and so show its "
        f"difference from the stand-in too; its position models drift, being unstable. {_OWN} "
        f"{STAND_IN}",
    )


def _closed_step(number: int, runs: Runs) -> Chart:
    record = runs.record("machine", "velocity", "rise")
    time = after_step(record)
    reference = leg_motion(record, "leg_reference", "in")
    histories = [
        History("demand", time, reference, GREY),
        History(_HARDWARE, time, leg_motion(record, "leg_position", "in"), COLOURS[1]),
    ]
    numbers = []
    for (name, velocity), colour, dash in zip(
        _velocities(runs, number), (COLOURS[0], COLOURS[2]), _DASHES, strict=True
    ):
        loop = closed_loop("velocity", velocity)
        reached = np.asarray(
            control.forced_response(loop, np.arange(time.size) * FRAME, reference).outputs
        )
        histories.append(History(name, time, reached, colour, dash))
        numbers.append(f"{name} peaks at {reached.max():.2f} in")
    peak = leg_motion(record, "leg_position", "in").max()
    return Chart(
        (motion(histories, "extension of leg 1 [in]", (-0.1, 2.0)),),
        f"Heave step of -1 in, velocity FB closed around linear model #{number} (Figure 4-5): "
        f"{'; '.join(numbers)}; the stand-in at {peak:.2f} in. {_OWN} {STAND_IN}",
    )


def _fast_sine(runs: Runs) -> Chart:
    record = runs.record("machine", "velocity", "sine_5_hz")
    reference = leg_motion(record, "leg_reference", "in")
    measured = leg_motion(record, "leg_position", "in")
    histories = [
        History("demand", record.time, reference, GREY),
        History(_HARDWARE, record.time, measured, COLOURS[1]),
    ]
    middle = (record.time > 1.5) & (record.time < 2.5)
    sizes = [f"stand-in {np.ptp(measured[middle]) / 2:.3f} in"]
    for (name, velocity), colour in zip(
        _velocities(runs, 1), (COLOURS[0], COLOURS[2]), strict=True
    ):
        loop = closed_loop("velocity", velocity)
        even = np.arange(record.time.size) * FRAME
        reached = np.asarray(control.forced_response(loop, even, reference).outputs)
        histories.append(History(name, record.time, reached, colour, "dash"))
        sizes.append(f"{name} {np.ptp(reached[middle]) / 2:.3f} in")
    return Chart(
        (motion(histories, "extension of leg 1 [in]", (1.5, 2.5), x_title="time [s]"),),
        f"Heave of 0.33 in at 5 Hz. Amplitudes: {'; '.join(sizes)}. {_OWN} {STAND_IN}",
    )


def _responses(numbers: tuple[int, ...], runs: Runs) -> Chart:
    responses = [Response(_HARDWARE, runs.case("machine", "velocity").response, GREY, "dot")]
    marks = []
    for number, colour in zip(numbers, COLOURS, strict=False):
        for (name, velocity), dash in zip(_velocities(runs, number), _DASHES, strict=True):
            loop = closed_loop("velocity", velocity)
            responses.append(Response(name, loop_response(loop, _LINES), colour, dash))
        marks.append(printed("velocity", "heave", f"linear_{number}", colour, table="4-1"))
    return Chart(
        bode(responses, marks, gain_range=(-20.0, 10.0)),
        f"Velocity FB closed around the linear models, leg reference to leg position. {CIRCLES} "
        f"{_OWN} {STAND_IN}",
    )


def _model_a(runs: Runs) -> Chart:
    plant = leg_plant(*(report_model(number) for number in ("4.4", "4.5", "4.6")))
    loop = closed_loop("velocity", plant)
    found = measure_loop(loop)
    record = runs.record("machine", "velocity", "rise")
    time = after_step(record)
    reference = leg_motion(record, "leg_reference", "in")
    reached = np.asarray(
        control.forced_response(loop, np.arange(time.size) * FRAME, reference).outputs
    )
    model = runs.case("model", "velocity")
    histories = [
        History("demand", time, reference, GREY),
        History(_HARDWARE, time, leg_motion(record, "leg_position", "in"), COLOURS[1]),
        History(
            "non-linear model",
            after_step(model.step),
            -leg_motion(model.step, "leg_position", "in"),
            COLOURS[2],
        ),
        History("linear model A", time, reached, COLOURS[0], "dash"),
    ]
    return Chart(
        (motion(histories, "extension of leg 1 [in]", (-0.1, 2.0)),),
        "Heave step of -1 in (non-linear model: +1 in, turned over), velocity FB. Linear model "
        "A is "
        f"Eqs 4.4 to 4.6: -90 deg at {found.phase_bandwidth_hz:.2f} Hz, -3 dB at "
        f"{found.gain_bandwidth_hz:.2f} Hz, damping ratio {found.damping_ratio:.2f}. Its "
        "speed "
        f"is 0.352 in/s per %, that of the stand-in 0.35, that of the non-linear model 0.277. "
        f"{MODEL} {STAND_IN}",
    )


_VALIDATION = Wanted("machine", "velocity", "heave", "multisine")
_RISE = Wanted("machine", "velocity", "heave", "rise")
_DATA = tuple(
    Wanted("machine", "velocity", "heave", cast("Signal", signal))
    for signal in IDENTIFIED_ON.values()
)
_MODELS = (*_DATA, _VALIDATION)
"""Runs that the identified models need; all three are made together."""


def _model_figure(
    number: str, title: str, draw: Callable[[Runs], Chart], *needs: Wanted
) -> ReportFigure:
    return ReportFigure(number, title, (*_MODELS, *needs), draw)


FIGURES = (
    ReportFigure(
        "4-1",
        "Linear model A and the hardware",
        (_RISE, *cases("model", ("velocity",))),
        _model_a,
    ),
    ReportFigure("4-2", "Pulse data of linear model #1", (_DATA[0],), _pulse_data),
    _model_figure("4-3", "Linear model #1 in open loop", partial(_open_loop, 1, 0.5, (0.5, 6.0))),
    _model_figure(
        "4-4", "Linear model #1 in open loop, enlarged", partial(_open_loop, 1, 0.5, (0.95, 1.7))
    ),
    _model_figure("4-6", "Linear model #1, heave step of -1 in", partial(_closed_step, 1), _RISE),
    _model_figure(
        "4-7",
        "Linear model #1, 0.33 in at 5 Hz",
        _fast_sine,
        Wanted("machine", "velocity", "heave", "sine_5_hz"),
    ),
    _model_figure("4-8", "Linear model #2 on its sine", partial(_open_loop, 2, 0.0, (2.0, 6.0))),
    _model_figure("4-9", "Linear model #2, heave step of -1 in", partial(_closed_step, 2), _RISE),
    _model_figure(
        "4-10",
        "Frequency responses of linear models #1 and #2",
        partial(_responses, (1, 2)),
        *cases("machine", ("velocity",)),
    ),
    _model_figure("4-11", "Linear model #3 on its sweep", partial(_open_loop, 3, 0.0, (5.0, 22.0))),
    _model_figure("4-12", "Linear model #3, heave step of -1 in", partial(_closed_step, 3), _RISE),
    _model_figure(
        "4-13",
        "Frequency responses of linear models #1, #2 and #3",
        partial(_responses, (1, 2, 3)),
        *cases("machine", ("velocity",)),
    ),
)
