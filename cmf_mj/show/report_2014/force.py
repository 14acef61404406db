"""Force feedback: why the legs oscillate, and how fast at other gains."""

import numpy as np

from cmf_mj.analysis.linear.poles import Oscillation, limit_cycle, oscillation
from cmf_mj.analysis.published import published_results
from cmf_mj.control.law import load_law
from cmf_mj.show.chart import Curve, Panel
from cmf_mj.show.look import COLOURS
from cmf_mj.show.report_2014.curves import Block, PageFigure, figure, texts
from cmf_mj.show.report_2014.runs import Runs, hydraulics_of

_PRINTED = next(row for row in published_results() if row.acceleration_g is not None)
REPORTED_HZ, REPORTED_G = (
    float(_PRINTED.oscillation_hz or 0.0),
    float(_PRINTED.acceleration_g or 0.0),
)
"""Of the oscillation in Figures 3-20 and 3-21, section 3.4.2."""


def _gain_figure() -> PageFigure:
    """Frequency and damping of the least damped pair over the force gain."""
    sizes = np.geomspace(0.1, 10.0, 41)
    base = load_law("force")

    def at(size: float) -> Oscillation:
        gains = base.direct_gain.model_copy(update={"force": -0.01 * float(size)})
        return oscillation(base.model_copy(update={"direct_gain": gains}), hydraulics_of("model"))

    poles, damping, crossover, _ = map(np.array, zip(*map(at, sizes), strict=True))
    frequencies = (
        Curve("unstable poles", sizes, poles, COLOURS[0]),
        Curve("phase crossover", sizes, crossover, COLOURS[1], "dash"),
    )
    ratio = Panel(
        "damping ratio of the poles",
        (Curve("unstable poles", sizes, damping, COLOURS[0]),),
        guides=(0.0,),
        x_title="force gain over the printed 0.01 % per lbf",
        x_range=(0.1, 10.0),
        x_log=True,
    )
    frequency = Panel("frequency [Hz]", frequencies, (5.0, 30.0), guides=(REPORTED_HZ,))
    title = "Least damped poles over the force gain"
    return figure("figure-force", title, "force_gain", (frequency, ratio))


def blocks(runs: Runs) -> list[Block]:
    """The section on the oscillation of section 3.4.2."""
    cycle_hz, pressure, acceleration = limit_cycle(runs.case("model", "force").step)
    reported = {"reported_hz": REPORTED_HZ, "reported_g": REPORTED_G, "cycle_hz": cycle_hz}
    first, second, third = texts("force", **reported, acceleration=acceleration, pressure=pressure)
    return [first, second, _gain_figure(), third]
