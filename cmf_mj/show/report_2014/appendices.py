"""Figures of Appendices B and D: all degrees of freedom, on both plants."""

from collections.abc import Sequence
from functools import partial

from cmf_mj.show.report_2014.chart import COLOURS, Chart, Dash
from cmf_mj.show.report_2014.curves import (
    CIRCLES,
    PLANT_TITLES,
    ReportFigure,
    Response,
    bode,
    cases,
    law_title,
    printed,
)
from cmf_mj.show.report_2014.runs import On, Runs

FLOWN = ("original", "velocity")
"""Laws of Appendix B."""

NEW = ("position_error_rate", "acceleration")
"""Laws of Appendix D."""

BOTH_SIGNS = (*NEW, "acceleration_opposing")
"""With the other sign of the acceleration gain, the one that Eq 3.4 implies."""

_B = ("heave", "surge", "sway", "pitch", "roll", "yaw")
_D = ("surge", "sway", "roll", "pitch", "yaw")


def _both(laws: Sequence[str], dof: str, note: str, runs: Runs) -> Chart:
    responses, marks, ringing = [], [], []
    plants: tuple[On, ...] = ("machine", "model")
    for law, colour in zip(laws, COLOURS, strict=False):
        for on in plants:
            result = runs.case(on, law, dof)
            name = f"{law_title(law)}, {PLANT_TITLES[on]}"
            dash: Dash = "solid" if on == "machine" else "dash"
            responses.append(Response(name, result.response, colour, dash))
            if not result.metrics.stable:
                ringing.append(name)
        marks.append(printed(law, dof, "nonlinear", colour))
        if dof == "heave":
            marks.append(printed(law, dof, "hardware", colour, "printed, hardware"))
    size = "0.33 in" if dof in ("surge", "sway", "heave") else "0.2 deg"
    unstable = f" The step rings on undiminished: {'; '.join(ringing)}." if ringing else ""
    circles = f" {CIRCLES}" if any(on_gain or on_phase for on_gain, on_phase in marks) else ""
    return Chart(
        bode(responses, marks, gain_range=(-20.0, 20.0)),
        f"{dof.capitalize()}, {size} chirp. Hexapod: the machine's stand-in, GFD, hardware set. "
        f"Single legs: the report's model, report set. {note}{unstable}{circles}",
    )


_HARDWARE_NOTE = "The report shows the machine here."
_MODEL_NOTE = (
    "The report shows its model here, in which all degrees of freedom are alike; on the hexapod "
    "surge and sway carry five times the mass."
)

FIGURES = (
    *(
        ReportFigure(
            f"B-{number}",
            f"Original and velocity feedback, {dof}",
            (*cases("machine", FLOWN, (dof,)), *cases("model", FLOWN, (dof,))),
            partial(_both, FLOWN, dof, _HARDWARE_NOTE),
        )
        for number, dof in enumerate(_B, 1)
    ),
    *(
        ReportFigure(
            f"D-{number}",
            f"Position error rate and acceleration feedback, {dof}",
            (*cases("machine", BOTH_SIGNS, (dof,)), *cases("model", BOTH_SIGNS, (dof,))),
            partial(_both, BOTH_SIGNS, dof, _MODEL_NOTE),
        )
        for number, dof in enumerate(_D, 1)
    ),
)
