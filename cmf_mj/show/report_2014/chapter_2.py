"""Figures of chapter 2: axes, the original and the velocity feedback compensator."""

from cmf_mj.show.report_2014.chart import COLOURS, GREY, Chart
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
    step_history,
)
from cmf_mj.show.report_2014.runs import LEG, Runs, Wanted

_STEP = (-0.2, 3.0)
_NON_LINEAR, _HARDWARE = "non-linear model", "hardware stand-in"


def _coordinates(runs: Runs) -> Chart:
    record = runs.record("machine", "velocity", "rise")
    time = after_step(record)
    heave, leg = (
        motion(
            [
                History(
                    f"demand, {name}",
                    time,
                    sign * step_history(record, "leg_reference", along),
                    GREY,
                ),
                History(
                    f"response, {name}", time, sign * step_history(record, "leg_position", along), c
                ),
            ],
            title,
            _STEP,
            x_title=x_title,
            height=1.0,
        )
        for name, along, sign, title, x_title, c in (
            ("degree of freedom", "heave", 1.0, "heave, down [in]", "", COLOURS[0]),
            ("leg", LEG, -1.0, "extension of leg 1 [in]", "time after the step [s]", COLOURS[1]),
        )
    )
    reached = -step_history(record, "leg_reference", LEG)[-1]
    return Chart(
        (heave, leg),
        f"The same step in both coordinates: -1 in of heave, z down, raises the platform and asks "
        f"{reached:+.3f} in of each leg, the direction cosine of a leg to the vertical. Velocity "
        f"FB. {STAND_IN}",
    )


def _responses(law: str, runs: Runs) -> Chart:
    responses = [
        Response(_NON_LINEAR, runs.case("model", law).response, COLOURS[0]),
        Response(f"{_HARDWARE}, chirp", runs.case("machine", law).response, COLOURS[1]),
        Response(f"{_HARDWARE}, 35 sines of Table 2-3", runs.rounds(law), COLOURS[1], marks=True),
    ]
    marks = [
        printed(law, "heave", "nonlinear", COLOURS[0], "printed, non-linear model"),
        printed(law, "heave", "hardware", COLOURS[2], "printed, hardware"),
    ]
    return Chart(
        bode(responses, marks),
        f"Heave, 0.33 in, leg demand to leg feedback. {MODEL} {STAND_IN} The report drove its "
        f"model with the chirp and its hardware with the sines. {CIRCLES}",
    )


def _steps(law: str, runs: Runs) -> Chart:
    model, machine = runs.case("model", law), runs.case("machine", law)
    time = after_step(model.step)
    histories = [
        History("demand", time, step_history(model.step, "leg_reference", "heave"), GREY),
        History(_NON_LINEAR, time, step_history(model.step, "leg_position", "heave"), COLOURS[0]),
        History(
            _HARDWARE,
            after_step(machine.step),
            step_history(machine.step, "leg_position", "heave"),
            COLOURS[1],
        ),
    ]
    numbers = "; ".join(
        f"{name}: overshoot {100 * m.overshoot:.0f} %, damping ratio {m.damping_ratio:.2f}, "
        f"steady-state error {100 * m.steady_state_error:.1f} %"
        for name, m in ((_NON_LINEAR, model.metrics), (_HARDWARE, machine.metrics))
    )
    return Chart(
        (motion(histories, "heave [in]", _STEP),),
        f"Heave step of 1 in, down. {numbers}. {MODEL} {STAND_IN}",
    )


def _needs(law: str) -> tuple[Wanted, ...]:
    return (*cases("model", [law]), *cases("machine", [law]))


def _rounds(law: str) -> Wanted:
    return Wanted("machine", law, "heave", "rounds")


FIGURES = (
    ReportFigure(
        "2-4",
        "Responses depending on the coordinate system",
        (Wanted("machine", "velocity", "heave", "rise"),),
        _coordinates,
    ),
    ReportFigure(
        "2-12",
        "Frequency response of hardware and non-linear model, original law",
        (*_needs("original"), _rounds("original")),
        lambda runs: _responses("original", runs),
    ),
    ReportFigure(
        "2-13",
        "Step response of hardware and non-linear model, original law",
        _needs("original"),
        lambda runs: _steps("original", runs),
    ),
    ReportFigure(
        "2-15",
        "Frequency response of velocity feedback",
        (*_needs("velocity"), _rounds("velocity")),
        lambda runs: _responses("velocity", runs),
    ),
    ReportFigure(
        "2-16",
        "Step response of velocity feedback",
        _needs("velocity"),
        lambda runs: _steps("velocity", runs),
    ),
)
