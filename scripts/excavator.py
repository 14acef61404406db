"""An excavator digs: pressures, sag of the supply and where the power goes, as text and figure.

Closed loop, the law makes the cylinders follow a cycle of lengths; open loop, `--lever` opens the
valves by so many per cent, in half a second, holds them so and closes them in half a second: 300 t
of reflected mass stopped in less burst the hoses, and there are no shock valves in the model.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from cmf_mj import Plant, Record, attach_hydraulics, drive, load_law, simulate
from cmf_mj.cli.common import refuse
from cmf_mj.core import units
from cmf_mj.core.units import FRAME
from cmf_mj.machine import models
from cmf_mj.plant.hydraulics import ENERGIES
from cmf_mj.show.look import legend
from cmf_mj.signals.composite import waypoints

CYLINDERS = ("boom_cylinder", "stick_cylinder", "bucket_cylinder")


def main() -> None:
    """Parse the arguments, run and report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--hydraulics", type=Path, default=models.model_path("excavator_hydraulics.toml")
    )
    parser.add_argument("--law", default=str(models.model_path("excavator_laws.toml")))
    parser.add_argument(
        "--cycle",
        type=Path,
        default=models.model_path("excavator_cycle.csv"),
        help="CSV with a header: time [s] and the length of each cylinder [m]",
    )
    parser.add_argument(
        "--lever",
        metavar="BOOM,STICK,BUCKET",
        help="per cent of the valves, open loop, e.g. --lever=50,0,-20",
    )
    parser.add_argument("--seconds", type=float, default=3.0, help="how long the lever is held")
    parser.add_argument("--out", type=Path, default=Path("out/excavator"))
    options = parser.parse_args()
    try:
        plant = attach_hydraulics(models.model_path("excavator.xml"), CYLINDERS, options.hydraulics)
        record = (
            pull(plant, options.lever, options.seconds) if options.lever else dig(plant, options)
        )
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
    options.out.mkdir(parents=True, exist_ok=True)
    print(report(plant, record))
    draw(plant, record, options.out / "excavator.png")
    record.save(options.out / "excavator.parquet")
    print(f"wrote {options.out / 'excavator.png'} and excavator.parquet")


def dig(plant: Plant, options: argparse.Namespace) -> Record:
    """Follow the cycle."""
    table = np.genfromtxt(options.cycle, delimiter=",", names=True)
    missing = {"time", *CYLINDERS} - set(table.dtype.names or ())
    if missing:
        raise ValueError(f"{options.cycle}: has no column {', '.join(sorted(missing))}")
    lengths = np.column_stack([table[name] for name in CYLINDERS])
    path = waypoints(table["time"], lengths - plant.neutral)
    start = plant.configuration(path[0])
    return simulate(plant, load_law(options.law), path, legs=True, start=start, record_every=8)


def pull(plant: Plant, lever: str, seconds: float) -> Record:
    """Hold the levers between half a second of rest before and two after."""
    try:
        opening = np.array([float(part) for part in lever.split(",")]) * units.PERCENT
    except ValueError:
        raise ValueError(f"lever: {lever!r} must be numbers, e.g. 50,0,-20") from None
    if opening.size != plant.legs:
        raise ValueError(f"lever: {lever!r} must be {plant.legs} numbers, one a cylinder")
    if not seconds > 0.0:
        raise ValueError(f"seconds: {seconds} must be greater than 0")
    time = np.arange(0.0, seconds + 3.5, FRAME)
    share = np.interp(time, [0.5, 1.0, 1.0 + seconds, 1.5 + seconds], [0.0, 1.0, 1.0, 0.0])
    return drive(plant, share[:, None] * opening, record_every=8)


def report(plant: Plant, record: Record) -> str:
    """Pressures, supply and energies as text."""
    bar, minute = 1e-5, 6e4
    lines = [f"{'':16}{'length':>16}{'cap':>12}{'rod':>12}{'force':>12}{'error':>8}"]
    lines.append(f"{'':16}{'m':>16}{'bar':>12}{'bar':>12}{'kN':>12}{'mm':>8}")
    for leg, name in enumerate(plant.actuators):
        length = record["leg_extension"][:, leg] + plant.neutral[leg]
        cells = [(length, "7.2f", 16)]
        cells += [(record[f"{side}_pressure"][:, leg] * bar, ".0f", 12) for side in ("cap", "rod")]
        cells.append((record["leg_force"][:, leg] * 1e-3, ".0f", 12))
        text = "".join(f"{f'{v.min():{f}} .. {v.max():{f}}':>{width}}" for v, f, width in cells)
        error = "-"
        if "leg_reference" in record.channels:
            missed = record["leg_reference"][:, leg] - record["leg_extension"][:, leg]
            error = f"{np.abs(missed).max() * 1e3:.0f}"
        lines.append(f"{name:16}{text}{error:>8}")
    supply = record["supply_pressure"]
    lines.append(
        f"supply {supply[0] * bar:.0f} bar, least {supply.min() * bar:.0f} bar; "
        f"pump at most {record['pump_flow'].max() * minute:.0f} l/min"
    )
    passed = dict(zip(ENERGIES, record["energy"][-1], strict=True))
    passed["rods"] = passed.pop("mechanical") - passed["friction"]
    shares = [f"{name} {value * 1e-3:.1f}" for name, value in passed.items() if abs(value) >= 50.0]
    lines.append(f"energy [kJ]: {', '.join(shares)}")
    return "\n".join(lines)


def draw(plant: Plant, record: Record, file: Path) -> None:
    """Lengths, pressures and powers over time."""
    figure = Figure(figsize=(9.0, 9.5), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True)
    colours = ("#0072b2", "#d55e00", "#009e73")
    time = record.time
    for leg, (name, colour) in enumerate(zip(plant.actuators, colours, strict=True)):
        label = name.removesuffix("_cylinder")
        if "leg_reference" in record.channels:
            asked = record["leg_reference"][:, leg] + plant.neutral[leg]
            axes[0].plot(time, asked, color=colour, linestyle=":")
        length = record["leg_extension"][:, leg] + plant.neutral[leg]
        axes[0].plot(time, length, color=colour, label=label)
        axes[1].plot(time, 100.0 * record["valve_opening"][:, leg], color=colour)
        axes[2].plot(time, record["cap_pressure"][:, leg] * 1e-5, color=colour)
        axes[2].plot(time, record["rod_pressure"][:, leg] * 1e-5, color=colour, linestyle="--")
    axes[2].plot(time, record["supply_pressure"] * 1e-5, color="black", label="supply")
    axes[2].plot([], [], color="grey", label="cap")
    axes[2].plot([], [], color="grey", linestyle="--", label="rod")
    for name, colour in zip(
        ("pump", "valves", "lines", "mechanical"), (*colours, "black"), strict=True
    ):
        power = np.gradient(record["energy"][:, ENERGIES.index(name)], time)
        axes[3].plot(time, power * 1e-3, color=colour, label=name)
    for axis, label in zip(
        axes, ("length [m]", "valve opening [%]", "pressure [bar]", "power [kW]"), strict=True
    ):
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
        if axis.get_legend_handles_labels()[0]:
            legend(axis)
    axes[-1].set_xlabel("time [s]")
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main()
