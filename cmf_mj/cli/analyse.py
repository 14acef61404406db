"""Analyse: `cmf linearize`, `modes`, `measure` and `identify`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from cmf_mj.cli import options
from cmf_mj.cli.common import app, in_si, noise_choice, pose_option, progress_bar, show, written
from cmf_mj.cli.options import choice
from cmf_mj.core.errors import InputError

command = partial(app.command, rich_help_panel="Analyse")

_NEUTRAL = "0,0,0,0,0,0"

_METHODS = "arx (least squares) or oe (output error)"
_SIGNALS = "multisine, chirp, noise, pulse or sine"
_METHOD, _SIGNAL = "studies.identification:Method", "studies.identification:Signal"
_ESTIMATOR = "analysis.spectra:Estimator"


@command("linearize")
def linearize_command(
    plant: options.PlantName = "hexapod",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    law: options.Law = "velocity",
    pose: options.Pose = _NEUTRAL,
    dofs: options.AnyDofs = options.ALL,
    out: options.Out = Path("out/linearize"),
) -> None:
    """Linearise a plant: modes, Bode diagrams, a law around it."""
    from cmf_mj.analysis.linear.linear import Linear
    from cmf_mj.plant.hexapod import make_plant
    from cmf_mj.show import linearization as report
    from cmf_mj.studies.linearization import linearization_study

    machine = make_plant(plant, cab, hydraulics)
    study = linearization_study(Linear(machine, pose_option(pose)), law, dofs)
    paths = report.save_study(study, out)
    show(report.pole_table(study), report.loop_table(study), written(paths, out))


@command("modes")
def modes_command(
    cabs: options.Cabs = options.ALL,
    hydraulics: options.Hydraulics = "hardware",
    pose: options.Pose = _NEUTRAL,
    samples: Annotated[int, Option(min=90, help="poses of the envelope")] = 1000,
    rounds: Annotated[int, Option(min=0, help="generations of the search, at most")] = 200,
    seed: options.Seed = 0,
    points: Annotated[int, Option(min=3, help="excursions along each axis of a map")] = 21,
    out: options.Out = Path("out/modes"),
    video: options.FilmFile = None,
    fps: options.Fps = 15,
    speed: options.Speed = 0.05,
    camera: options.Camera = "overview",
    width: options.Width = 320,
    height: options.Height = 260,
    stroke: Annotated[float, options.film(help="largest leg motion [in]")] = 12.0,
    periods: Annotated[float, options.film(help="length, in periods of the lowest mode")] = 1.0,
) -> None:
    """Reflected mass, hydraulic modes at a pose and over the envelope, and the worst pose."""
    from cmf_mj.analysis.modes import over_envelope, plane_map, sweep
    from cmf_mj.core import units
    from cmf_mj.core.files import in_folder
    from cmf_mj.machine.geometry import DOFS
    from cmf_mj.plant.hexapod import Hexapod
    from cmf_mj.show import linearization as report
    from cmf_mj.show.film.film import FilmSettings, swing_film

    plants = [Hexapod(name, hydraulics) for name in cabs]
    here = pose_option(pose)
    at_pose = [plant.hydraulic_modes(here) for plant in plants]
    looks, legs = FilmSettings(fps, speed, camera, width, height), units.to_si("in", stroke)

    # The search takes longest: what the rest refuses is refused before it.
    paths = []
    name = Path(video or "")
    for plant, modes in zip(plants, at_pose, strict=True) if video else ():
        path = in_folder(out, f"{name.stem}_{plant.cab}{name.suffix}")
        swings: dict[str, Any] = {"stroke": legs, "periods": periods}
        with progress_bar("drawing") as progress:
            paths.append(swing_film(plant, modes, path, looks, **swings, progress=progress))
    sweeps = [[sweep(plant, dof, count=points) for dof in DOFS] for plant in plants]
    maps = [[plane_map(p, pair, count=points) for pair in report.PLANES] for p in plants]
    with progress_bar() as progress:
        ranges = [
            over_envelope(plant, samples=samples, rounds=rounds, seed=seed, progress=progress)
            for plant in plants
        ]
    paths += report.save_envelope(ranges, sweeps, maps, out)
    # The envelope has neutral in it.
    off_neutral = at_pose if here.any() else []
    each = [*off_neutral, *(modes for one in ranges for modes in (*one.modes, one.worst))]
    paths += report.save_modes(each, out)
    for modes in at_pose:
        show(report.mass_table(modes), report.mode_table(modes))
    for one in ranges:
        show(report.mode_table(one.worst, "worst pose"))
    show(report.range_table(ranges), written(paths, out))


def _files_or(simulate: bool, files: list[Path] | None) -> None:
    if simulate == bool(files):
        raise InputError("files: name recordings, or use --simulate, not both and not neither")


@command("measure")
def measure_command(
    files: options.Recordings = None,
    simulate: options.Simulate = False,
    law: options.Law = "velocity",
    dof: options.Dof = "heave",
    plant: options.PlantName = "hexapod",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    amplitude: options.Amplitude = None,
    noise: options.Noise = False,
    estimator: Annotated[str, choice(_ESTIMATOR, "ESTIMATOR", "h1, h2, hv or report")] = "h1",
    out: options.Out = Path("out/measure"),
) -> None:
    """Measure recordings (several are rounds of one), or a simulated session."""
    from cmf_mj.show import measurement as report
    from cmf_mj.studies.case import make_case
    from cmf_mj.studies.measurement import measure, measure_recordings

    _files_or(simulate, files)
    if simulate:
        sensors, size = noise_choice(noise), in_si(dof, amplitude)
        machine = (plant, cab, hydraulics)
        measured = measure(make_case(law, dof, *machine, amplitude=size, electronics=sensors))
        paths = report.save_measurement(measured, out)
        table = report.measurement_table(measured)
    else:
        measures = measure_recordings(files or [], dof, estimator)
        paths = report.save_recordings(measures, out)
        table = report.recordings_table(measures)
    show(table, written(paths))


def parse_orders(text: str) -> tuple[int, int, int]:
    """Orders of the command line, `na,nb,nk`."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3 or not all(part.isdigit() for part in parts):
        raise InputError(f"orders: {text!r} is refused; allowed: na,nb,nk such as 4,3,1")
    na, nb, nk = (int(part) for part in parts)
    return na, nb, nk


@command("identify")
def identify_command(
    files: options.Recordings = None,
    simulate: options.Simulate = False,
    law: options.OtherLaw = None,
    dof: options.AnyDof = "heave",
    plant: options.PlantName = "hexapod",
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    amplitude: options.Amplitude = None,
    signal: Annotated[str, choice(_SIGNAL, "SIGNAL", _SIGNALS)] = "multisine",
    method: Annotated[str, choice(_METHOD, "METHOD", _METHODS)] = "oe",
    orders: Annotated[str | None, Option(metavar="NA,NB,NK", help="default by search")] = None,
    out: options.Out = Path("out/identify"),
) -> None:
    """Identify a linear model of leg velocity per valve command; the last file validates."""
    from cmf_mj.record.reader import read_recording
    from cmf_mj.show import measurement as report
    from cmf_mj.studies import identification as studies
    from cmf_mj.studies.case import make_case

    _files_or(simulate, files)
    chosen = None if orders is None else parse_orders(orders)
    name, machine = law or "velocity", (plant, cab, hydraulics)
    step = None
    if simulate:
        case, law = make_case(name, dof, *machine, amplitude=in_si(dof, amplitude)), name
        records = studies.simulated_records(case, signal)  # type: ignore[arg-type]
        step = case.run(case.step())
    else:
        records = [read_recording(path) for path in files or []]
    options: dict[str, Any] = {"method": method, "orders": chosen, "law": law, "step": step}
    model = studies.identify(records, dof, **options)
    paths = report.save_identification(model, out)
    show(report.orders_table(model), report.model_table(model), written(paths))
