"""A linearised plant with loops of a law, and hydraulic modes: study, tables, figures, files."""

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
    loops: dict[str, FrequencyResponse]  #: Position per demand under the law, likewise.
    stable: bool  #: The verdict on all of these loops.
    slowest_pole: complex  #: The pole of the loops that grows most, or decays least [rad/s].
    margins: NDArray[np.float64]  #: Of the loops: gain [dB], phase [deg], (n, 2).


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
    poles = np.concatenate([loop.poles() for loop in loops.values()])
    frame = loops[signals[0]].dt
    return LinearizationStudy(
        linear=linear,
        law=load_law(law).name,
        modes=linear.modes(),
        responses=responses,
        loops={name: loop_response(loop, FREQUENCIES) for name, loop in loops.items()},
        stable=are_stable(poles),
        slowest_pole=complex(np.log(poles[np.abs(poles).argmax()] + 0j) / frame),
        margins=linear.margins(law, signals),
    )


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


_LEAST_SHARE = 0.1  #: Of a kind of state or a degree of freedom that a table names.


def _plant_text(study: LinearizationStudy) -> str:
    plant, pose = study.linear.plant, np.asarray(study.linear.pose, dtype=float)
    name = f"{plant.name} {plant.cab}".strip().replace("_", " ")
    return f"{name}, {plant.parameters.name}, {pose_text(pose)}"


def _shares_text(share_by_name: Mapping[str, float]) -> str:
    """The largest shares, in their order."""
    names = sorted(share_by_name, key=lambda name: -share_by_name[name])
    largest = [name for name in names if share_by_name[name] >= _LEAST_SHARE]
    return ", ".join(f"{name} {share_by_name[name]:.2f}" for name in largest)


def pole_table(study: LinearizationStudy) -> Table:
    """All modes: pole, frequency, damping, participation; one row for poles that coincide."""
    groups: list[list[Mode]] = []
    for mode in study.modes:
        if groups and np.isclose(mode.pole, groups[-1][0].pole, rtol=1e-6, atol=1e-6):
            groups[-1].append(mode)
        else:
            groups.append([mode])
    rows = []
    for group in groups:
        mode, *others = group
        pole, hertz = f"{mode.pole.real:.4g}", f"{mode.frequency / (2.0 * np.pi):.3g}"
        if np.isnan(mode.damping_ratio):
            pole = hertz = "0"
        elif mode.pole.imag > 0.0:
            pole += f" ± {mode.pole.imag:.4g}j"
        mechanical_share = mode.participation["motion"] + mode.participation["oil"]
        dofs = legs = ""
        if not others and mechanical_share >= _LEAST_SHARE:
            dofs = _shares_text(dict(zip(DOFS, mode.dof_shares, strict=True)))
            legs = " ".join(f"{size:.2f}" for size in np.abs(mode.leg_shape))
        states = _shares_text(mode.participation)
        rows.append((pole, hertz, mode.damping_ratio, str(len(group)), states, dofs, legs))
    columns = ("pole [rad/s]", ("Hz", ""), ("damping", ".3f"), ("times", ""))
    return Table(
        f"modes: {_plant_text(study)}",
        (*columns, "states", "degrees of freedom", "legs"),
        rows,
        "shares of states by participation factors, of degrees of freedom in the leg "
        "motion; legs: size of their motion. Poles that coincide share a line and have no shapes.",
    )


def loop_table(study: LinearizationStudy) -> Table:
    """Bandwidths and margins of the law's loops."""
    rows = []
    for (name, response), margins in zip(study.loops.items(), study.margins, strict=True):
        measures = measures_from(bandwidths(response))
        widths = measures.gain_bandwidth_hz, measures.peak_gain_db
        cells = (phase_text(measures), *widths, *margins)
        rows.append((name, *(cells if study.stable else ["unstable"] * len(cells))))
    width_columns = (("-90 deg [Hz]", ".2f"), ("-3 dB [Hz]", ".2f"), ("peak [dB]", ".2f"))
    margin_columns = (("gain margin [dB]", ".1f"), ("phase margin [deg]", ".0f"))
    return Table(
        f"{study.law} around the linearised plant",
        ("dof", *width_columns, *margin_columns),
        rows,
        f"'-': not reached below {FREQUENCIES[-1]:g} Hz; margins: at the valve commands along one "
        "axis, the others closed; negative: of a gain that falls, or a phase that leads"
        + _growth_text(study),
    )


def _growth_text(study: LinearizationStudy) -> str:
    """The motion that grows in loops that are not stable."""
    if study.stable:
        return ""
    pole = study.slowest_pole
    hertz, damping = abs(pole) / (2.0 * np.pi), -pole.real / abs(pole)
    growth = f"at {hertz:.2f} Hz grows, damping ratio {damping:.3f}"
    if pole.imag == 0.0:
        growth = f"grows without swinging, by {pole.real:.3g} 1/s"
    return (
        f". Unstable: motion {growth}; `cmf tune` finds gains. Poles of the plant itself that lie "
        "slightly above 0 are its free drift"
    )


def save_study(study: LinearizationStudy, folder: Path) -> list[Path]:
    """Write the state space as JSON, the modes as CSV, all figures as PNG."""
    description = study.linear.plant.describe()
    description = {key: description[key] for key in description if key != "hydraulic_parameters"}
    description |= {"pose": study.linear.pose, "operating_point": study.linear.point}
    files: dict[str, Any] = {
        "state_space.json": partial(save_system, study.linear.system, description=description),
        "modes.csv": pole_table(study),
    }
    title = f"Position per command, all legs by J\n{_plant_text(study)}"
    plant_figure, gain, _ = look.bode_figure(title, study.responses)
    gain.set(ylabel="gain [dB of m]")
    unstable = "" if study.stable else ", unstable"
    title = f"Demand to position, {study.law}{unstable}\n{_plant_text(study)}"
    loop_figure, *_ = look.bode_figure(title, study.loops, stable=study.stable, limits=True)
    return look.save_files(files | {"bode.png": plant_figure, "loop.png": loop_figure}, folder)


_LINE_STYLES: tuple[Literal["-", "--", ":", "-."], ...] = ("-", "--", ":", "-.")
_NAMING_SHARE = 0.05  #: Share of the kinetic energy above which a degree of freedom names a mode.
_LISTED_SHARE = 0.02  #: Share above which a table lists it.


def _energy_shares(shares: NDArray[np.float64]) -> list[tuple[str, float]]:
    """Degrees of freedom and their shares of a mode's kinetic energy, the largest first."""
    return [(DOFS[dof], float(shares[dof])) for dof in np.argsort(-shares)]


def mode_names(modes: HydraulicModes) -> list[str]:
    """One or two degrees of freedom with most of each mode's kinetic energy, as its name."""
    pairs = (_energy_shares(shares)[:2] for shares in modes.share.T)
    return [" with ".join(dof for dof, share in pair if share > _NAMING_SHARE) for pair in pairs]


def _names_at_neutral(envelope: EnvelopeModes) -> list[str]:
    """Names of the modes at the first pose, which is neutral."""
    return mode_names(envelope.modes[0])


def mode_table(modes: HydraulicModes, name: str = "") -> Table:
    """Frequency, mass a leg feels, and what moves in each mode; `name` is the pose's."""
    rows = []
    properties = (mode_names(modes), modes.frequency_hz, modes.leg_mass, modes.share.T)
    for mode, hertz, leg_mass, shares in zip(*properties, strict=True):
        listed = [(dof, share) for dof, share in _energy_shares(shares) if share > _LISTED_SHARE]
        text = ", ".join(f"{dof} {100.0 * share:.0f} %" for dof, share in listed)
        rows.append((mode, hertz, units.from_si("lbm", leg_mass), text))
    columns = ("mode", ("frequency [Hz]", ".2f"), ("mass a leg feels [lbm]", ".0f"))
    title = ", ".join(filter(None, (modes.cab.upper(), name, pose_text(modes.pose, ".1f"))))
    return Table(title, (*columns, "share of the kinetic energy"), rows)


def range_table(ranges: Sequence[EnvelopeModes]) -> Table:
    """The frequencies over the envelope, a row a cab and mode, which has its name at neutral."""
    rows = []
    for envelope in ranges:
        percentiles = np.percentile(envelope.frequency_hz, [5.0, 50.0, 95.0], axis=0)
        lowest = np.minimum(envelope.frequency_hz.min(axis=0), envelope.worst.frequency_hz)
        modes = zip(_names_at_neutral(envelope), lowest, *percentiles, strict=True)
        rows += [(envelope.worst.cab, *mode) for mode in modes]
    titles = ("lowest [Hz]", "5 % below", "half below", "95 % below")
    columns = ("cab", "mode", *((title, ".2f") for title in titles))
    return Table("over the envelope", columns, rows)


def sweep_figure(ranges: Sequence[EnvelopeModes], sweeps: Sequence[Sequence[Sweep]]) -> Figure:
    """Six modes, by their names at neutral, along each degree of freedom; a line style a cab."""
    figure = look.new_figure(10.0, 6.8)
    panels = figure.subplots(2, 3, sharey=True)
    for line, sweeps_of_cab in zip(cycle(_LINE_STYLES), sweeps, strict=False):
        for axes, sweep in zip(panels.flat, sweeps_of_cab, strict=True):
            unit = dof_unit(sweep.dof)
            excursion = units.from_si(unit, sweep.excursion)
            for hertz, colour in zip(sweep.frequency_hz.T, look.COLOURS, strict=False):
                axes.plot(excursion, hertz, line, color=colour)
            down = ", down" if sweep.dof == "heave" else ""
            axes.set_xlabel(f"{sweep.dof} [{unit}]{down}")
    for axes in panels[:, 0]:
        look.frequency_axis(axes.yaxis)
    names_by_mode = zip(*(_names_at_neutral(envelope) for envelope in ranges), strict=True)
    entries = [
        Line2D([], [], color=colour, label=" or ".join(dict.fromkeys(names)))
        for names, colour in zip(names_by_mode, look.COLOURS, strict=False)
    ]
    entries += [
        Line2D([], [], color=look.DARK, linestyle=line, label=envelope.worst.cab.upper())
        for envelope, line in zip(ranges, cycle(_LINE_STYLES), strict=False)
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
        for envelope in ranges
        for modes in (*envelope.modes, envelope.worst)
    ]
    files = {
        "modes_sweep.png": sweep_figure(ranges, sweeps),
        "modes.csv": rows,
        "modes.md": range_table(ranges),
    }
    return look.save_files(files, folder, 100)
