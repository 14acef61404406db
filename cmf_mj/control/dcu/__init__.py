"""The Digital Control Unit (DCU): host frames in, platform demand at 2048 Hz out.

    host (<= 80 Hz) -> [ acceptance -> buffer -> interpolation -> limit -> transport line ] -> DCL

In the frame loop, for each frame that has arrived `receive(dcu, state, sequence, time, values)`,
then `step(dcu, state, demand)`. Compiled, without allocation; knows neither plant nor sockets.
"""

from cmf_mj.control.dcu.acceptance import receive
from cmf_mj.control.dcu.arrivals import Arrivals, feed, upsample
from cmf_mj.control.dcu.play import step
from cmf_mj.control.dcu.settings import (
    Dcu,
    DcuLimits,
    DcuSettings,
    DelayBreakdown,
    load_dcu,
    make_dcu,
)
from cmf_mj.control.dcu.state import (
    REASONS,
    DcuState,
    Verdict,
    output_bounds,
    resting,
)

__all__ = [
    "REASONS",
    "Arrivals",
    "Dcu",
    "DcuLimits",
    "DcuSettings",
    "DcuState",
    "DelayBreakdown",
    "Verdict",
    "feed",
    "load_dcu",
    "make_dcu",
    "output_bounds",
    "receive",
    "resting",
    "step",
    "upsample",
]
