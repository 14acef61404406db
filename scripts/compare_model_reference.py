"""What do the model reference laws give? Beside the laws of the report, and on slow and fast legs.

Runs the comparison on the hexapod, then a sine in heave on single legs 30 % slow and fast, where
the adaptive law finds the feed-forward that the fixed one lacks.
"""

import argparse
from pathlib import Path

from matplotlib.figure import Figure

from cmf_mj.cli.common import refuse
from cmf_mj.cli.simulate import run_comparison
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.facility.replay import replay
from cmf_mj.facility.simulate import simulate
from cmf_mj.machine.geometry import DOFS
from cmf_mj.plant.parameters.loading import load_hydraulics
from cmf_mj.plant.single_legs import SingleLegs
from cmf_mj.signals.single import sine

REPORT_LAWS = ["velocity", "position_error_rate", "acceleration_eq_3_6"]
LAWS = ["model_following", "model_reference_adaptive"]
SPEEDS = (0.7, 1.0, 1.3)


def adaptation_figure(hydraulics: str, cycles: float) -> Figure:
    """Factor and error of leg 1 in a heave sine of 2 in and 0.4 Hz, legs of other speeds."""
    parameters = load_hydraulics(hydraulics)
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    factor, error = figure.subplots(2, 1, sharex=True)
    command = sine("heave", 2.0 * units.INCH, 0.4, cycles=cycles)
    for colour, share in zip(("C0", "C1", "C2"), SPEEDS, strict=True):
        speed = parameters.leg_speed
        other = speed.model_copy(update={"value": share * speed.value})
        plant = SingleLegs(parameters.model_copy(update={"leg_speed": other}))
        for name, line in zip(LAWS, (":", "-"), strict=True):
            record = simulate(plant, name, command)
            label = f"speed {share:g}, {load_law(name).title}"
            factor.plot(record.time, replay(record, name).factor[:, 0], colour + line, label=label)
            missed = (record["leg_reference"] - record["leg_position"])[:, 0] / units.INCH
            error.plot(record.time, missed, colour + line)
        factor.axhline(1.0 / share, color=colour, linewidth=0.6, linestyle="--")
    factor.set_ylabel("factor of the feed-forward")
    factor.legend(fontsize=8, ncols=3, loc="upper center", bbox_to_anchor=(0.5, 1.3))
    error.set_ylabel("demand less position, leg 1 [in]")
    error.set_xlabel("time [s]")
    for axis in (factor, error):
        axis.grid(alpha=0.3)
    return figure


def main() -> None:
    """Parse the arguments and run the study."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cab", default="gfd", help="gfd, rfd, ifd or a TOML file")
    parser.add_argument("--hydraulics", default="hardware", help="report, hardware or a TOML file")
    parser.add_argument("--dofs", nargs="+", choices=DOFS, default=["surge", "heave", "pitch"])
    parser.add_argument("--laws", nargs="+", default=[*REPORT_LAWS, *LAWS])
    parser.add_argument("--jobs", type=int, help="threads; default one a core")
    parser.add_argument("--out", type=Path, default=Path("out/model_reference"))
    parser.add_argument("--quick", action="store_true", help="shorter sweeps and sines")
    options = parser.parse_args()
    try:
        run_comparison(
            options.laws,
            options.dofs,
            options.out,
            plants=["hexapod"],
            cab=options.cab,
            hydraulics=options.hydraulics,
            jobs=options.jobs,
            quick=options.quick,
            records=False,
        )
        figure = adaptation_figure(options.hydraulics, 2.0 if options.quick else 16.0)
    except (ValueError, OSError) as error:
        refuse(error)
    figure.savefig(options.out / "adaptation.png", dpi=150)


if __name__ == "__main__":
    main()
