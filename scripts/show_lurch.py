"""Why does the integrator need its trigger? Raising from the stops, with it and without.

Before the rise the legs lie on the mechanical stops, below the settled reference. Without the
trigger the error of that half inch is integrated all the while (section 3.2.1).
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj import Hexapod, load_law
from cmf_mj.cli.common import refuse
from cmf_mj.control.states import Request, State
from cmf_mj.core import units
from cmf_mj.facility.host.stream import make_stream
from cmf_mj.facility.operation import Operation, operate

NO_TRIGGER = -40.0
"""Below the mechanical stop [in]: no leg comes there."""

CASES = {
    "with the trigger": (-37.0, "default"),
    "without, protected": (NO_TRIGGER, "default"),
    "without, unprotected": (NO_TRIGGER, None),
}
"""Trigger [in] and protection of the runs."""


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


def draw(runs: dict[str, Operation], wait: float) -> Figure:
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
    axes[0].legend(fontsize=8)
    axes[0].set_title(f"raise from the stops, requested after {wait:g} s")
    axes[2].set(xlabel="time [s]", xlim=(wait - 1.0, wait + 12.0))
    return figure


def main() -> None:
    """Parse the arguments, run and draw."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--law", default="velocity_integral", help="a law with an integral")
    parser.add_argument("--wait", type=float, default=60.0, help="time on the stops [s]")
    parser.add_argument("--out", type=Path, default=Path("out/lurch.png"))
    options = parser.parse_args()
    try:
        runs = {name: rise(*case, options.law, options.wait) for name, case in CASES.items()}
        options.out.parent.mkdir(parents=True, exist_ok=True)
        draw(runs, options.wait).savefig(options.out, dpi=110)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
    for name, run in runs.items():
        record = run.record
        speed = np.abs(np.diff(record["leg_extension"], axis=0)).max() * record.rate
        print(f"{name}: {speed / units.INCH:.1f} in/s, fault {run.record.metadata['fault']}")
    print(options.out)


if __name__ == "__main__":
    main()
