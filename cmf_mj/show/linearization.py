"""Tables, figures and files of a linearised plant, and of hydraulic modes over the envelope."""

import json
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Any, Literal, NamedTuple

import control
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cmf_mj.analysis.frequency_response import FrequencyResponse, bandwidths
from cmf_mj.analysis.linear.linear import Linear
from cmf_mj.analysis.linear.loop import loop_response
from cmf_mj.analysis.linear.plants import reduced
from cmf_mj.analysis.linear.poles import Mode, are_stable
from cmf_mj.analysis.measures import measures_from
from cmf_mj.analysis.modes import EnvelopeModes, Sweep
from cmf_mj.control.law import load_law
from cmf_mj.core import units
from cmf_mj.core.errors import InputError
from cmf_mj.core.files import write_text
from cmf_mj.core.result import Table
from cmf_mj.machine.geometry import DOFS, dof_unit, pose_text
from cmf_mj.plant.hexapod import HydraulicModes
from cmf_mj.show import look
from cmf_mj.show.comparison import phase_text

FREQUENCIES = np.geomspace(0.1, 20.0, 400)  #: Lines of the responses [Hz].


class LinearizationStudy(NamedTuple):
    """A plant linearised in a configuration, with loops of one law."""

    linear: Linear
    law: str
    modes: tuple[Mode, ...]
    responses: dict[str, FrequencyResponse]  #: Position per command, by degree of freedom or leg.
    loops: dict[str, FrequencyResponse]  #: Demand to position under the law.
    stable: bool  #: The verdict on all of these loops.
    fastest: complex  #: Of their poles that which grows most, or decays least [rad/s].
    margins: NDArray[np.float64]  #: Of these loops: gain [dB], phase [deg], (n, 2).


def linearization_study(linear: Linear, law: str, signals: Sequence[str]) -> LinearizationStudy:
    """Close a law around a linearised plant; `signals` are degrees of freedom or legs."""
    if not signals:
        raise InputError("signals: none; degrees of freedom or legs are needed")
    loops = {name: linear.loop(law, name) for name in signals}
    plants = {name: linear.model(name) for name in signals}
    responses = {
        name: loop_response(reduced(plant, outputs=plant.output_labels[:1]), FREQUENCIES)
        for name, plant in plants.items()
    }
    closed = {name: loop_response(loop, FREQUENCIES) for name, loop in loops.items()}
    poles = np.concatenate([loop.poles() for loop in loops.values()])
    fastest = complex(np.log(poles[np.abs(poles).argmax()] + 0j) / next(iter(loops.values())).dt)
    found = linear.modes(), responses, closed, are_stable(poles), fastest
    return LinearizationStudy(linear, load_law(law).name, *found, linear.margins(law, signals))


def save_system(system: control.StateSpace, path: Path, description: Mapping[str, Any]) -> Path:
    """Write a state space as JSON; numbers read back bit for bit.

    `A` to `D`, `sampling_time` and the labels make a `control.ss` of it again; `description` are
    plain JSON values kept with it, such as plant and pose.
    """
    content = {
        "name": system.name,
        "sampling_time": system.dt,
        "units": "SI; commands as fractions; angles in rad",
        "description": description,
    }
    names = ("input_labels", "output_labels", "state_labels", *"ABCD")
    content |= {name: getattr(system, name) for name in names}
    return write_text(path, json.dumps(look.plain_data(content), allow_nan=False) + "\n")


_NAMED = 0.1  #: Share from which on a kind of state or a degree of freedom is named.


def _title(study: LinearizationStudy) -> str:
    plant, pose = study.linear.plant, np.asarray(study.linear.pose, dtype=float)
    name = f"{plant.name} {plant.cab}".strip().replace("_", " ")
    return f"{name}, {plant.parameters.name}, {pose_text(pose)}"


def _largest(names: Sequence[str], shares: Sequence[float]) -> str:
    order = sorted(zip(names, shares, strict=True), key=lambda item: -item[1])
    return ", ".join(f"{name} {share:.2f}" for name, share in order if share >= _NAMED)


def pole_table(study: LinearizationStudy) -> Table:
    """All modes: pole, frequency, damping, what takes part; one row for poles that coincide."""
    groups: list[list[Mode]] = []
    for mode in study.modes:
        if groups and np.isclose(mode.pole, groups[-1][0].pole, rtol=1e-6, atol=1e-6):
            groups[-1].append(mode)
        else:
            groups.append([mode])
    rows = []
    for mode, *others in groups:
        pole, hertz = mode.pole, mode.frequency / (2.0 * np.pi)
        still, pair = np.isnan(mode.damping_ratio), pole.imag > 0.0
        text = f"{pole.real:.4g}" + (f" ± {pole.imag:.4g}j" if pair else "")
        numbers = ("0", "0") if still else (text, f"{hertz:.3g}")
        states = _largest(list(mode.participation), list(mode.participation.values()))
        shapes = ("", "")
        if not others and mode.participation["motion"] + mode.participation["oil"] >= _NAMED:
            legs = " ".join(f"{size:.2f}" for size in np.abs(mode.leg_shape))
            shapes = (_largest(DOFS, list(mode.dof_shares)), legs)
        rows.append((*numbers, mode.damping_ratio, str(1 + len(others)), states, *shapes))
    columns = ("pole [rad/s]", ("Hz", ""), ("damping", ".3f"), ("times", ""))
    return Table(
        f"modes: {_title(study)}",
        (*columns, "states", "degrees of freedom", "legs"),
        rows,
        "shares of states by participation factors, of degrees of freedom in the leg "
        "motion; legs: size of their motion. Poles that coincide share a line and have no shapes.",
    )


def loop_table(study: LinearizationStudy) -> Table:
    """Bandwidths and margins of the law's loops."""
    rows = []
    for (name, loop), of in zip(study.loops.items(), study.margins, strict=True):
        measures = measures_from(bandwidths(loop))
        found = (phase_text(measures), *measures[1:3], *of)
        rows.append((name, *(found if study.stable else ("unstable",) * 5)))
    widths = (("-90 deg [Hz]", ".2f"), ("-3 dB [Hz]", ".2f"), ("peak [dB]", ".2f"))
    margins = (("gain margin [dB]", ".1f"), ("phase margin [deg]", ".0f"))
    return Table(
        f"{study.law} around the linearised plant",
        ("dof", *widths, *margins),
        rows,
        f"'-': not reached below {FREQUENCIES[-1]:g} Hz; margins: at the valve commands along one "
        "axis, the others closed; negative: of a gain that falls, or a phase that leads"
        + _growth(study),
    )


def _growth(study: LinearizationStudy) -> str:
    """What grows in loops that are not stable."""
    if study.stable:
        return ""
    pole = study.fastest
    hertz, damping = abs(pole) / (2.0 * np.pi), -pole.real / abs(pole)
    what = f"at {hertz:.2f} Hz grows, damping ratio {damping:.3f}"
    if pole.imag == 0.0:
        what = f"grows without swinging, by {pole.real:.3g} 1/s"
    return (
        f". Unstable: motion {what}; `cmf tune` finds gains. Poles of the plant itself that lie "
        "slightly above 0 are its free drift"
    )


def save_study(study: LinearizationStudy, folder: Path) -> list[Path]:
    """Write the state space as JSON, the modes as CSV, all figures as PNG."""
    known = study.linear.plant.describe().items()
    description = {name: value for name, value in known if name != "hydraulic_parameters"}
    description |= {"pose": study.linear.pose, "operating_point": study.linear.point}
    files: dict[str, Any] = {
        "state_space.json": partial(save_system, study.linear.system, description=description),
        "modes.csv": pole_table(study),
    }
    title = f"Position per command, all legs by J\n{_title(study)}"
    figure, gain, _ = look.bode_figure(title, study.responses)
    gain.set(ylabel="gain [dB of m]")
    unstable = "" if study.stable else ", unstable"
    title = f"Demand to position, {study.law}{unstable}\n{_title(study)}"
    loops = look.bode_figure(title, study.loops, stable=study.stable, limits=True)[0]
    return look.save_files(files | {"bode.png": figure, "loop.png": loops}, folder)


_STYLES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")
_MOVES = 0.05  #: Share of the kinetic energy from which on a degree of freedom names a mode.


def mode_names(modes: HydraulicModes) -> list[str]:
    """What moves in each mode: most of the kinetic energy, and the next that has a part of it."""
    orders = ((shares, np.argsort(-shares)[:2]) for shares in modes.share.T)
    moving = ([DOFS[k] for k in order if shares[k] > _MOVES] for shares, order in orders)
    return [" with ".join(names) for names in moving]


def mode_table(modes: HydraulicModes, name: str = "") -> Table:
    """Frequency, mass a leg feels, and what moves in each mode; `name` is the pose's."""
    rows = []
    for i, (named, shares) in enumerate(zip(mode_names(modes), modes.share.T, strict=True)):
        order = [k for k in np.argsort(-shares) if shares[k] > 0.02]
        moving = ", ".join(f"{DOFS[k]} {100.0 * shares[k]:.0f} %" for k in order)
        mass = units.from_si("lbm", modes.leg_mass[i])
        rows.append((named, modes.frequency_hz[i], mass, moving))
    numbers = ("mode", ("frequency [Hz]", ".2f"), ("mass a leg feels [lbm]", ".0f"))
    title = ", ".join(filter(None, (modes.cab.upper(), name, pose_text(modes.pose, ".1f"))))
    return Table(title, (*numbers, "share of the kinetic energy"), rows)


def range_table(ranges: Sequence[EnvelopeModes]) -> Table:
    """The frequencies over the envelope, a row a cab and mode, which has its name at neutral."""
    rows = []
    for each in ranges:
        shares = np.percentile(each.frequency_hz, [5.0, 50.0, 95.0], axis=0)
        least = np.minimum(each.frequency_hz.min(axis=0), each.worst.frequency_hz)
        named = zip(mode_names(each.modes[0]), least, *shares, strict=True)
        rows += [(each.worst.cab, *row) for row in named]
    names = ("lowest [Hz]", "5 % below", "half below", "95 % below")
    columns = ("cab", "mode", *((name, ".2f") for name in names))
    return Table("over the envelope", columns, rows)


def sweep_figure(ranges: Sequence[EnvelopeModes], sweeps: Sequence[Sequence[Sweep]]) -> Figure:
    """Six modes, by their names at neutral, along each degree of freedom; a line style a cab."""
    figure = look.new_figure(10.0, 6.8)
    panels = figure.subplots(2, 3, sharey=True)
    for style, of_cab in zip(cycle(_STYLES), sweeps, strict=False):
        for axis, one in zip(panels.flat, of_cab, strict=True):
            along = units.from_si(dof_unit(one.dof), one.excursion)
            for mode, colour in zip(one.frequency_hz.T, look.COLOURS, strict=False):
                axis.plot(along, mode, style, color=colour)
            down = ", down" if one.dof == "heave" else ""
            axis.set_xlabel(f"{one.dof} [{dof_unit(one.dof)}]{down}")
    for axis in panels[:, 0]:
        look.frequency_axis(axis.yaxis)
    alike = zip(*(mode_names(each.modes[0]) for each in ranges), strict=True)
    named = [" or ".join(dict.fromkeys(names)) for names in alike]
    pairs = zip(named, look.COLOURS, strict=False)
    entries = [Line2D([], [], color=colour, label=name) for name, colour in pairs]
    entries += [
        Line2D([], [], color=look.DARK, linestyle=style, label=each.worst.cab.upper())
        for each, style in zip(ranges, cycle(_STYLES), strict=False)
    ]
    look.legend(figure, handles=entries)
    figure.suptitle("Hydraulic modes along each degree of freedom, all others at neutral")
    return figure


def save_modes(
    ranges: Sequence[EnvelopeModes], sweeps: Sequence[Sequence[Sweep]], folder: Path
) -> list[Path]:
    """Write the figure `modes_sweep.png`, `range_table` and `modes.csv`.

    `modes.csv` has the six frequencies at each pose [m, rad] of each cab, the worst pose last.
    """
    rows = [
        {
            "cab": modes.cab,
            **dict(zip(DOFS, modes.pose, strict=True)),
            **{f"mode_{i}_hz": hertz for i, hertz in enumerate(modes.frequency_hz, start=1)},
        }
        for each in ranges
        for modes in (*each.modes, each.worst)
    ]
    files = {
        "modes_sweep.png": sweep_figure(ranges, sweeps),
        "modes.csv": rows,
        "modes.md": range_table(ranges),
    }
    return look.save_files(files, folder, 100)
