"""How is a leg demand met that leaves its limits? Position, velocity and acceleration of one leg.

Left a step beyond the stroke and back, right a sine that leaves the stroke: the demand, what a
plain clamp to the stroke makes of it, and what the limits of the control law do.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cmf_mj.cli.common import refuse
from cmf_mj.control.limiter import Limiter, limit_history, make_leg_limiter
from cmf_mj.core import units
from cmf_mj.core.units import FRAME
from cmf_mj.machine.motion_limits import load_motion_limits

_ROWS = (
    ("position [in]", units.INCH),
    ("velocity [in/s]", units.INCH),
    ("acceleration [g]", units.STANDARD_GRAVITY),
)


def demands(seconds: float = 6.0) -> dict[str, NDArray[np.float64]]:
    """Leg demands [m] by title."""
    time = np.arange(0.0, seconds, FRAME)
    step = np.where((time > 0.5) & (time < 3.0), 45.0, 0.0) * units.INCH
    sine = (28.0 - 14.0 * np.cos(2.0 * np.pi * 0.25 * time)) * units.INCH
    return {"step beyond the stroke": step, "sine beyond the stroke": sine}


def draw(limiter: Limiter) -> Figure:
    """The figure: three rows of derivatives, a column per demand."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    axes = figure.subplots(3, 2, sharex=True, sharey="row")
    end = limiter.high[0]
    bounds = (end, limiter.velocity[0], limiter.acceleration[0])
    for column, (title, demand) in enumerate(demands().items()):
        found = limit_history(limiter, demand[:, None])
        motions = {
            "demand": (demand, "0.6", 1.2),
            "clamped": (np.clip(demand, -end, end), "#e69f00", 1.2),
            "limited": (found.position[:, 0], "#0072b2", 1.6),
        }
        time = np.arange(demand.size) * FRAME
        for name, (motion, colour, width) in motions.items():
            first = np.diff(motion, prepend=motion[0]) / FRAME
            second = np.diff(first, prepend=first[0]) / FRAME
            for axis, values, (_, unit) in zip(
                axes[:, column], (motion, first, second), _ROWS, strict=True
            ):
                axis.plot(time, values / unit, color=colour, linewidth=width, label=name)
        axes[0, column].set_title(title)
        axes[2, column].set_xlabel("time [s]")
    for row, (label, unit) in enumerate(_ROWS):
        axes[row, 0].set_ylabel(label)
        for axis in axes[row]:
            axis.grid(True, color="0.9", linewidth=0.6)
            for sign in (-1.0, 1.0):
                axis.axhline(sign * bounds[row] / unit, color="0.3", linewidth=0.8, linestyle=":")
        axes[row, 0].set_ylim(*(s * 1.35 * bounds[row] / unit for s in (-1.0, 1.0)))
    axes[0, 0].legend(fontsize=8, loc="lower right", framealpha=0.9)
    return figure


def main() -> None:
    """Parse the arguments and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--limits", type=Path, help="TOML file of limits that differ")
    parser.add_argument("--out", type=Path, default=Path("out/limits.png"))
    options = parser.parse_args()
    try:
        figure = draw(make_leg_limiter(load_motion_limits(options.limits), legs=1))
        options.out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(options.out, dpi=110)
    except (ValueError, OSError) as error:
        refuse(error)
    print(options.out)


if __name__ == "__main__":
    main()
