"""`cmf modes`."""

from pathlib import Path
from typing import Annotated

import typer

from cmf_mj.analysis.modes import over_envelope, plane_map, sweep, within_stroke
from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Camera,
    Fps,
    HydraulicSet,
    Speed,
    app,
    names_of,
    pose_option,
    progress_bar,
    refuse,
    show,
    written,
)
from cmf_mj.core import units
from cmf_mj.machine import models
from cmf_mj.machine.kinematics import DOFS
from cmf_mj.plant.hexapod import Hexapod, HydraulicModes
from cmf_mj.show import modes as modes_report
from cmf_mj.show.film.swing import SwingSettings, swing_film

_FILM = SwingSettings()

_ROOM = 0.25
"""Part of the leg motion asked for that a film near the worst pose can show of every mode."""


@app.command("modes")
def modes_command(
    cab: Annotated[str, typer.Option(help="gfd, rfd, ifd, several of them, or `all`")] = "all",
    hydraulics: HydraulicSet = "hardware",
    pose: Annotated[
        str, typer.Option(help="surge,sway,heave [in],roll,pitch,yaw [deg], z down")
    ] = "0,0,0,0,0,0",
    samples: Annotated[int, typer.Option(help="poses of the envelope looked at")] = 1000,
    rounds: Annotated[int, typer.Option(help="generations of the search, at most")] = 200,
    seed: Annotated[int, typer.Option(help="of samples and search of the worst pose")] = 0,
    points: Annotated[int, typer.Option(help="excursions along each axis of a map")] = 21,
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/modes"),
    video: Annotated[
        Path | None,
        typer.Option(
            metavar="NAME.mp4|NAME.gif",
            help="film the modes at the pose and near the worst: NAME_CAB and NAME_CAB_worst",
        ),
    ] = None,
    fps: Fps = _FILM.fps,
    speed: Speed = _FILM.speed,
    camera: Camera = _FILM.camera,
    width: Annotated[int, typer.Option(help="of the picture of one mode, pixels")] = _FILM.width,
    height: Annotated[int, typer.Option(help="of the picture of one mode, pixels")] = _FILM.height,
    stroke: Annotated[
        float, typer.Option(help="largest leg motion shown [in]; less where a leg has less")
    ] = round(units.from_si("in", _FILM.stroke), 6),
    periods: Annotated[
        float, typer.Option(help="length of a film, in periods of the lowest mode")
    ] = _FILM.periods,
) -> None:
    """Reflected mass, hydraulic modes at a pose and over the envelope, and the worst pose."""
    try:
        plants = [Hexapod(name, hydraulics) for name in names_of(cab, tuple(models.CABS))]
        here = pose_option(pose)
        found = [plant.hydraulic_modes(here) for plant in plants]
        looks = SwingSettings(fps, speed, camera, width, height, units.to_si("in", stroke), periods)

        def filmed(
            name: Path, plant: Hexapod, modes: HydraulicModes, suffix: str = "", where: str = ""
        ) -> list[Path]:
            path = out / name.with_name(f"{name.stem}_{plant.cab}{suffix}{name.suffix}")
            title = modes_report.title_of(modes, where)
            with progress_bar() as progress:
                return [swing_film(plant, modes, path, looks, title=title, progress=progress)]

        # The search takes longest: what the rest refuses is refused before it.
        paths = []
        for plant, modes in zip(plants, found, strict=True):
            paths += filmed(video, plant, modes) if video is not None else []
        sweeps = [[sweep(plant, dof, count=points) for dof in DOFS] for plant in plants]
        maps = [[plane_map(p, pair, count=points) for pair in modes_report.PLANES] for p in plants]
        with progress_bar() as progress:
            ranges = [
                over_envelope(plant, samples=samples, rounds=rounds, seed=seed, progress=progress)
                for plant in plants
            ]
        paths += modes_report.save_envelope(ranges, sweeps, maps, out)
        # The envelope has neutral in it.
        asked = found if here.any() else []
        each = [*asked, *(modes for one in ranges for modes in (*one.modes, one.worst))]
        paths += modes_report.save_modes(each, out)
        for modes in found:
            show(modes_report.mass_table(modes), modes_report.mode_table(modes), width=TEXT_WIDTH)
        for one in ranges:
            show(modes_report.mode_table(one.worst, "worst pose"), width=TEXT_WIDTH)
        show(modes_report.range_table(ranges), width=TEXT_WIDTH)
        for plant, one in zip(plants, ranges, strict=True):
            if video is not None:
                near = within_stroke(plant, one.worst, _ROOM * looks.stroke)
                where = "worst pose" if near is one.worst else "near the worst pose"
                paths += filmed(video, plant, near, "_worst", where)
        show(written(paths, out), width=TEXT_WIDTH)
    except (ValueError, OSError) as error:
        refuse(error)
