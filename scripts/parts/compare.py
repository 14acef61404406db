"""Machines side by side: sizes, envelope, hydraulic modes, bandwidths of their laws, capacity.

Bandwidths are -90 deg and -3 dB of the linearised machine about neutral, small motion; capacity is
the largest velocity of a sine by the closed forms of `cmf_mj.studies.asymptotes`. Writes
one table a subject and `machines.png` below --out; docs/explanation/two_machines.md shows them for
the CMF and SIMONA.
"""

import argparse
from pathlib import Path

import control
import numpy as np
from matplotlib.figure import Figure

from cmf_mj import Hexapod, Linear, load_law, load_machine
from cmf_mj.analysis.frequency_response import line_bandwidths
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.core import units
from cmf_mj.core.result import Table
from cmf_mj.machine.geometry import DOFS, by_kind
from cmf_mj.show.look import frequency_axis, legend
from cmf_mj.studies.asymptotes import Asymptotes, asymptotes
from cmf_mj.studies.machine_check import MachineCheck, check_machine

LINES = np.arange(0.1, 25.0, 0.1)
"""Frequencies of the responses [Hz]."""

POSES = 50
"""Poses at which the condition number is looked for."""

SINES = (0.5, 1.0, 2.0, 5.0)
"""Frequencies of the capacity [Hz]."""

LIKE = {"cmf": "modal_plan"}
"""Law beside the one that a machine ships with: what compares like with like."""


def laws_of(name: str) -> tuple[str, ...]:
    """The law that a machine ships with, and the one of the same form as the others'."""
    return (load_machine(name).law, *([LIKE[name]] if name in LIKE else []))


def sizes(checks: list[MachineCheck]) -> Table:
    """What the machines are."""
    rows = []
    for check in checks:
        machine, cab = check.machine, check.cabs[0]
        half = machine.half_stroke
        short, long = machine.geometry.neutral.mean() - half, machine.geometry.neutral.mean() + half
        load = float(np.abs(cab.load).max())
        rows.append(
            (
                machine.name,
                cab.mass,
                f"{short:.3f} to {long:.3f}",
                1e-3 * load,
                min(check.stall) / load,
                float(cab.speed.min()),
                cab.sustained,
                check.worst_condition,
            )
        )
    columns = (
        "machine",
        ("payload [kg]", ".0f"),
        "legs [m]",
        ("static load [kN]", ".2f"),
        ("least stall force over it", ".2f"),
        ("leg speed [m/s]", ".2f"),
        ("heave sustained [m/s]", ".2f"),
        ("worst condition number", ".1f"),
    )
    return Table("sizes", columns, rows)


def envelopes(checks: list[MachineCheck]) -> Table:
    """Excursions of each degree of freedom alone, to the end of the first leg's working stroke."""
    rows = []
    for index, dof in enumerate(DOFS):
        ends = [
            units.from_si(by_kind(dof, "m", "deg"), end)
            for check in checks
            for end in check.envelope[index]
        ]
        rows.append((f"{dof} [{by_kind(dof, 'm', 'deg')}]", *ends))
    names = [(f"{c.machine.name} {end}", ".2f") for c in checks for end in ("from", "to")]
    return Table("envelope", ("alone", *names), rows)


def modes(checks: list[MachineCheck]) -> Table:
    """Hydraulic modes at neutral, lowest first."""
    rows = [(c.machine.name, c.cabs[0].cab, *c.cabs[0].modes) for c in checks]
    return Table("modes [Hz]", ("machine", "cab", *((str(i), ".1f") for i in range(1, 7))), rows)


def bandwidths(names: list[str]) -> Table:
    """-90 deg and -3 dB of each law in each degree of freedom [Hz]; beyond 25 Hz none."""
    rows = []
    for name in names:
        linear = Linear(Hexapod(machine=name))
        for source in laws_of(name):
            law = load_law(source)
            answer = control.frequency_response(linear.loop(law), 2.0 * np.pi * LINES).frdata
            found = [line_bandwidths(LINES, answer[i, i]) for i in range(len(DOFS))]
            for kind, at in (("phase", "-90 deg"), ("gain", "-3 dB")):
                hertz = [getattr(one, f"{kind}_hz") for one in found]
                rows.append((name, law.name, at, *hertz))
    columns = ("machine", "law", "at", *((dof, ".2f") for dof in DOFS))
    return Table("bandwidths [Hz]", columns, rows)


def capacity(names: list[str]) -> Table:
    """Largest velocity of a sine at neutral, and what limits it."""
    rows = []
    for name in names:
        plant = Hexapod(machine=name)
        for dof in ("surge", "heave", "pitch"):
            limits = asymptotes(plant, dof)
            unit = by_kind(dof, "m", "deg")
            cells = []
            for hertz in SINES:
                speeds = limits.velocities(hertz)
                speed, limit = min((speed, limit) for limit, speed in speeds.items())
                cells.append(f"{units.from_si(unit, speed):.3g} {limit.replace('_', ' ')}")
            rows.append((name, f"{dof} [{unit}/s]", *cells))
    return Table("capacity", ("machine", "sine in", *(f"{hertz:g} Hz" for hertz in SINES)), rows)


def draw(names: list[str]) -> Figure:
    """Gimbals from above and from the side, heave capacity and heave response."""
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    above, aside, able, follows = figure.subplots(2, 2).ravel()
    hertz = np.geomspace(0.1, 10.0, 200)
    for index, name in enumerate(names):
        machine, colour = load_machine(name), f"C{index}"
        shape, plant = machine.geometry, Hexapod(machine=name)
        for axis, rows in ((above, (1, 0)), (aside, (0, 2))):
            turn = np.array([1.0, 1.0 if rows[1] == 0 else -1.0])
            for low, high in zip(shape.lower, shape.upper, strict=True):
                axis.plot(
                    *(np.array([low, high])[:, rows] * turn).T, color=colour, marker="o", ms=4
                )
            ring = np.vstack([shape.upper, shape.upper[:1]])[:, rows] * turn
            axis.plot(*ring.T, color=colour, lw=2.5, label=name)
        limits: Asymptotes = asymptotes(plant, "heave")
        able.plot(hertz, [limits.velocity(f) for f in hertz], color=colour, label=name)
        linear = Linear(plant)
        for source, dash in zip(laws_of(name), ("-", "--"), strict=False):
            law = load_law(source)
            heave = loop_response(linear.loop(law, "heave"), hertz).response
            phase = np.degrees(np.unwrap(np.angle(heave)))
            follows.plot(hertz, phase, dash, color=colour, label=f"{name}, {law.name}")
    above.set(xlabel="y, right [m]", ylabel="x, forward [m]", title="legs from above")
    aside.set(xlabel="x, forward [m]", ylabel="height [m]", title="legs from the side")
    for axis in (above, aside):
        axis.set_aspect("equal")
    able.set(ylabel="velocity amplitude [m/s]", title="heave: largest sine")
    able.set_ylim(bottom=0.0)
    follows.set(ylabel="phase of the response [deg]", title="heave: small motion")
    follows.axhline(-90.0, color="0.5", lw=0.8)
    follows.set_ylim(-200.0, 5.0)
    for axis in (able, follows):
        frequency_axis(axis.xaxis)
    legend(above, able, follows)
    for axis in (above, aside, able, follows):
        axis.grid(alpha=0.3)
    return figure


def tables(names: list[str]) -> dict[str, Table]:
    """All tables by the name of their file."""
    checks = [check_machine(load_machine(name), poses=POSES) for name in names]
    return {
        "sizes": sizes(checks),
        "envelope": envelopes(checks),
        "modes": modes(checks),
        "bandwidths": bandwidths(names),
        "capacity": capacity(names),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--machines", default="cmf,simona", help="names or files")
    parser.add_argument("--out", type=Path, default=Path("out/machines"))


def run(options: argparse.Namespace) -> None:
    """Write tables and picture."""
    names = options.machines.split(",")
    options.out.mkdir(parents=True, exist_ok=True)
    for name, table in tables(names).items():
        path = options.out / f"{name}.md"
        path.write_text(table.markdown(), encoding="utf-8")
        print(f"\n{table.markdown()}")
    draw(names).savefig(options.out / "machines.png", dpi=100)
    print(f"written to {options.out}: five tables, machines.png")
