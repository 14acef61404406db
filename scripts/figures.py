"""Draw pictures of the documentation that neither a command nor the gallery draws.

    python scripts/figures.py cycle     going up, following the host, coming down: operating states
    python scripts/figures.py limits    a leg demand that leaves its limits, clamped and limited
    python scripts/figures.py lurch     raising from the stops, with the integrator's trigger or not
    python scripts/figures.py rotation  damping over gain of acceleration and height of the cab
    python scripts/figures.py model     the machine with a cab, or the excavator

Without a display, MUJOCO_GL names the OpenGL to render with: egl or osmesa.
"""

import argparse
from pathlib import Path
from typing import Any

import matplotlib.image
import mujoco
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from cmf_mj import Hexapod, Linear, load_cab, load_law, signals
from cmf_mj.cli.common import refuse
from cmf_mj.control.limiter import Limiter, limit_history, make_leg_limiter
from cmf_mj.control.states import Request, State
from cmf_mj.core import units
from cmf_mj.core.units import FRAME
from cmf_mj.facility.host.stream import from_command, make_stream
from cmf_mj.facility.operation import Operation, operate
from cmf_mj.machine import models
from cmf_mj.machine.motion_limits import load_motion_limits
from cmf_mj.plant.hexapod import hexapod_model
from cmf_mj.report_2014.posterior.run import acceleration_law
from cmf_mj.show.look import DARK, legend, new_figure, save_figure
from cmf_mj.show.operation import overview_figure

NO_TRIGGER = -40.0
"""Below the mechanical stop [in]: no leg comes there."""

CASES = {
    "with the trigger": (-37.0, "default"),
    "without, protected": (NO_TRIGGER, "default"),
    "without, unprotected": (NO_TRIGGER, None),
}
"""Trigger [in] and protection of the runs of a lurch."""

ROWS = (
    ("position [in]", units.INCH),
    ("velocity [in/s]", units.INCH),
    ("acceleration [g]", units.STANDARD_GRAVITY),
)


def cycle(options: argparse.Namespace) -> None:
    """One cycle of the operating states."""
    operation = operate(
        Hexapod(),
        options.law,
        from_command(signals.sine("heave", 0.05, 0.5, cycles=18.0), rate=80.0),
        begin=State.OFF,
        requests=[(0.5, Request.ENGAGE), (19.0, Request.OFF)],
        seconds=options.seconds,
        record_every=8,
    )
    save_figure(overview_figure(operation.record), options.out)


def demands(seconds: float = 6.0) -> dict[str, NDArray[np.float64]]:
    """Leg demands [m] by title."""
    time = np.arange(0.0, seconds, FRAME)
    step = np.where((time > 0.5) & (time < 3.0), 45.0, 0.0) * units.INCH
    sine = (28.0 - 14.0 * np.cos(2.0 * np.pi * 0.25 * time)) * units.INCH
    return {"step beyond the stroke": step, "sine beyond the stroke": sine}


def draw_limits(limiter: Limiter) -> Figure:
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
                axes[:, column], (motion, first, second), ROWS, strict=True
            ):
                axis.plot(time, values / unit, color=colour, linewidth=width, label=name)
        axes[0, column].set_title(title)
        axes[2, column].set_xlabel("time [s]")
    for row, (label, unit) in enumerate(ROWS):
        axes[row, 0].set_ylabel(label)
        for axis in axes[row]:
            axis.grid(True, color="0.9", linewidth=0.6)
            for sign in (-1.0, 1.0):
                axis.axhline(sign * bounds[row] / unit, color="0.3", linewidth=0.8, linestyle=":")
        axes[row, 0].set_ylim(*(s * 1.35 * bounds[row] / unit for s in (-1.0, 1.0)))
    legend(figure)
    return figure


def limits(options: argparse.Namespace) -> None:
    """A leg demand that leaves its limits."""
    limiter = make_leg_limiter(load_motion_limits(options.limits), legs=1)
    save_figure(draw_limits(limiter), options.out)


def rise(
    trigger: float,
    protection: str | None,
    law: str = "velocity_integral",
    wait: float = 60.0,
    after: float = 12.0,
) -> Operation:
    """Lie on the stops for a time, then raise.

    Args:
        trigger: of the law's integrator [in].
        protection: as of `Run`.
        law: name of the law.
        wait: time on the stops [s].
        after: time from the request on [s].
    """
    time = np.arange(0.0, wait + after, 1.0 / 80.0)
    return operate(
        Hexapod(),
        load_law(law).model_copy(update={"integrator_trigger": trigger}),
        make_stream(time, np.zeros((time.size, 6)), derivatives="zero"),
        begin=State.OFF,
        requests=[(wait, Request.RAISE)],
        protection=protection,
        seconds=wait + after,
        record_every=4,
    )


def draw_lurch(runs: dict[str, Operation], wait: float) -> Figure:
    """Mean leg position, speed and valve command of all runs."""
    figure = Figure(figsize=(8.5, 8.0), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    labels = ("legs [in]", "leg speed [in/s]", "valve command [%]")
    colours = ("#0072b2", "#d55e00", "#e69f00")
    for (name, run), colour in zip(runs.items(), colours, strict=True):
        record, fault = run.record, run.record.metadata["fault"]
        position = record["leg_extension"].mean(axis=1)
        speed = np.gradient(position, record.time)
        said = "no fault" if fault is None else f"{fault['name']} at {fault['time']:.2f} s"
        for axis, values in zip(
            axes,
            (
                position / units.INCH,
                speed / units.INCH,
                100.0 * record["valve_command"].mean(axis=1),
            ),
            strict=True,
        ):
            axis.plot(record.time, values, color=colour, linewidth=1.2, label=f"{name}: {said}")
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
        axis.axvline(wait, color="0.3", linestyle=":")
        axis.grid(True, color="0.9", linewidth=0.6)
    legend(figure)
    axes[0].set_title(f"raise from the stops, requested after {wait:g} s")
    axes[2].set(xlabel="time [s]", xlim=(wait - 1.0, wait + 12.0))
    return figure


def lurch(options: argparse.Namespace) -> None:
    """Raise from the stops, with the integrator's trigger and without.

    Before the rise the legs lie on the mechanical stops, below the settled reference. Without the
    trigger the error of that half inch is integrated all the while (section 3.2.1).
    """
    runs = {name: rise(*case, options.law, options.wait) for name, case in CASES.items()}
    save_figure(draw_lurch(runs, options.wait), options.out)
    for name, run in runs.items():
        speed = np.abs(np.diff(run.record["leg_extension"], axis=0)).max() * run.record.rate
        print(f"{name}: {speed / units.INCH:.1f} in/s, fault {run.record.metadata['fault']}")


HEIGHTS, GAINS = np.linspace(0.0, 1.5, 41), np.linspace(-0.12, 0.06, 61)
"""Of the cab's centre of mass above the upper gimbals [m]; of acceleration [%/(in/s^2)]."""


def least_damping(cab: str, corner: float) -> NDArray[np.float64]:
    """Least damping ratios, (heights, gains), behind a filter of the accelerometer [Hz]."""
    laws, shipped = [acceleration_law(gain, corner) for gain in GAINS], load_cab(cab)
    found = []
    for height in HEIGHTS:
        place = [*shipped.centre_of_mass.si[:2], height]
        linear = Linear(Hexapod(shipped.changed("lifted", centre_of_mass=place)))
        found.append([linear.damping(law)["least"] for law in laws])
    return np.array(found)


def rotation(options: argparse.Namespace) -> None:
    """Damping over the gain of acceleration feedback and the height of the cab's centre of mass."""
    figure, law = new_figure(10.0, 4.2, gridded=False), load_law("acceleration_compensated")
    corner = -np.log(law.accelerometer_pole) / (2.0 * np.pi * FRAME)
    axes, cabs = figure.subplots(1, 2, sharey=True), {"gfd": "lightest", "ifd": "heaviest"}
    for axis, (cab, said) in zip(axes, cabs.items(), strict=True):
        damping = least_damping(cab, corner)
        levels = np.arange(-8, 7) / 50.0
        shades: dict[str, Any] = {"cmap": "RdBu", "vmin": -0.16, "vmax": 0.16, "extend": "both"}
        drawn = axis.contourf(GAINS, HEIGHTS, damping, levels, **shades)
        some = [-0.08, -0.04, 0.04, 0.08]
        axis.contour(GAINS, HEIGHTS, damping, some, colors=DARK, linewidths=0.6)
        axis.contour(GAINS, HEIGHTS, damping, [0.0], colors="k", linewidths=2.0)
        zero = float(GAINS[np.argmax(damping[-5] < 0.0)])
        axis.text(zero - 0.006, HEIGHTS[-3], "stable", ha="right", va="center")
        axis.text(zero + 0.006, HEIGHTS[-3], "unstable", ha="left", va="center")
        shipped = load_cab(cab).centre_of_mass.si[2]
        for gain, name in ((0.01, "as printed"), (-0.08, "as advised")):
            axis.plot(gain, shipped, "o", color="k")
            axis.annotate(name, (gain, shipped), (6.0, 6.0), textcoords="offset points")
        axis.xaxis.set_major_formatter("{x:.2f}")
        axis.yaxis.set_major_locator(MultipleLocator(0.25))
        axis.set(title=f"{cab.upper()}, the {said} cab", xlabel="gain of acceleration [%/(in/s²)]")
    axes[0].set_ylabel("cab's centre of mass above the gimbals [m]")
    scale = figure.colorbar(drawn, ax=axes, label="least damping ratio", pad=0.02)
    scale.set_ticks([-0.12, -0.08, -0.04, 0.0, 0.04, 0.08, 0.12])
    figure.suptitle("Damping with acceleration feedback behind Eq 3.6, model without friction")
    save_figure(figure, options.out)


def model(options: argparse.Namespace) -> None:
    """Picture of a machine."""
    if options.excavator:
        drawn = mujoco.MjModel.from_xml_path(str(models.model_path("excavator.xml")))
    else:
        drawn = hexapod_model(options.cab)
    data = mujoco.MjData(drawn)
    mujoco.mj_forward(drawn, data)
    with mujoco.Renderer(drawn, options.height, options.width) as renderer:
        renderer.update_scene(data, options.camera)
        pixels = renderer.render()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    matplotlib.image.imsave(options.out, pixels)


def main() -> None:
    """Draw the picture that is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    pictures = parser.add_subparsers(dest="picture", required=True)
    lengths = {cycle: 34.0, limits: None, lurch: None, rotation: None, model: None}
    for draw, seconds in lengths.items():
        name = draw.__name__
        one = pictures.add_parser(name, help=(draw.__doc__ or "").splitlines()[0])
        one.set_defaults(draw=draw)
        one.add_argument("--out", type=Path, default=Path(f"out/{name}.png"), metavar="FILE")
        if seconds is not None:
            one.add_argument("--seconds", type=float, default=seconds, help="length of the run")
        if draw in (cycle, lurch):
            one.add_argument("--law", default="velocity_integral", help="a law with an integral")
    limited, drawn = pictures.choices["limits"], pictures.choices["model"]
    limited.add_argument("--limits", type=Path, help="TOML file of limits that differ")
    pictures.choices["lurch"].add_argument(
        "--wait", type=float, default=60.0, help="time on the stops [s]"
    )
    drawn.add_argument("--cab", choices=models.CABS, default="gfd", help="default: %(default)s")
    drawn.add_argument("--excavator", action="store_true", help="draw the excavator instead")
    drawn.add_argument("--camera", default="overview", help="overview, side or front (hexapod)")
    drawn.add_argument("--width", type=int, default=1280, help="pixels, at most 1920")
    drawn.add_argument("--height", type=int, default=720, help="pixels, at most 1080")
    options = parser.parse_args()
    try:
        options.draw(options)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
    print(options.out)


if __name__ == "__main__":
    main()
