"""Facility: `cmf serve`, `operate`, `host`, `replay` and `export`."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

import cmf_mj
from cmf_mj.cli import options
from cmf_mj.cli.common import app, noise_option, progress_bar, show, written_text
from cmf_mj.cli.options import choice
from cmf_mj.core.errors import InputError

if TYPE_CHECKING:
    from cmf_mj.facility.host.stream import HostStream
    from cmf_mj.facility.operation import Operation
    from cmf_mj.facility.session import Session
    from cmf_mj.machine.cab import Cab

command = partial(app.command, rich_help_panel="Facility")
drawing = options.drawing(command)

BEGIN_STATES = {"engaged": "ENGAGED", "settled": "OFF"}  #: States in which a run may begin.

PROTOCOLS = ("cmf", "moog")  #: What a host may speak to `cmf serve`.
EXPORTS = ("library", "law", "fmu")  #: What `cmf export` writes.

_PROTOCOL = "cmf, or moog: a virtual Moog 6DOF2000E, begun off"
_BEGIN_HELP = "engaged, or settled: off on the stops, raised and engaged at once"
_SERVE_HELP = f"of cmf: {_BEGIN_HELP}; default engaged"
_EXPORTS = "library or fmu: the machine; law: a control law alone"

StreamFile = Annotated[Path, Argument(help="CSV or Parquet with time and six poses, SI")]
FrameRate = Annotated[
    float | None, Option(min=1.0, max=2048.0, help="frames a second; default as stamped")
]


def _begin_options(begin: str, noise: bool) -> dict[str, Any]:
    """Options of a run that begins in a state and is engaged at once."""
    from cmf_mj.control.states import Request, State

    return {
        "begin": State[BEGIN_STATES[begin]],
        "requests": [(0.0, Request.ENGAGE)],
        "electronics": noise_option(noise),
    }


def _end_text(operation: Operation) -> str:
    """End of the run in a sentence."""
    from cmf_mj.control.states import State

    record = operation.record
    state = State(int(record["operating_state"][-1])).name.lower()
    fault, late = record.metadata["fault"], record.metadata["host_late"]
    text = f"ended {state}, no fault"
    if fault is not None:
        leg = "" if fault["leg"] is None else f" of leg {fault['leg']}"
        text = f"ended {state}: {fault['name']}{leg} at {fault['time']:.3f} s"
    if late > 0.0:
        clock = float(record["host_clock"][-1])
        text += f"\nthe host was late for {late:.1f} s; at the end its clock ran at {clock:.3f}"
    return text


def _stream(file: Path, rate: float | None, cab: Cab | None = None) -> HostStream:
    from cmf_mj.facility.host.stream import read_stream, resample, unit_doubts

    stream = read_stream(file)
    doubts = unit_doubts(stream.time, stream.pose, cmf_mj.load_cab(cab).machine)
    show(*(f"{file}: {doubt}" for doubt in doubts))
    return stream if rate is None else resample(stream, rate)


@drawing("serve")
def serve_command(
    port: Annotated[int, Option(help="UDP port; 0 takes a free one")] = 2048,
    bind: Annotated[str, Option(help="IPv4 address to listen on")] = "127.0.0.1",
    host: Annotated[str, Option(help="the only host whose datagrams are taken")] = "127.0.0.1",
    host_port: Annotated[
        int | None, Option(min=1, max=65535, help="its only port; default any program of that host")
    ] = None,
    protocol: Annotated[str, choice("cli.facility:PROTOCOLS", "NAME", _PROTOCOL)] = "cmf",
    lockstep: Annotated[bool, Option("--lockstep", help="moog: 1/60 s a command")] = False,
    seconds: Annotated[float, Option(help="length of the run [s]")] = 60.0,
    law: options.Law = "velocity",
    machine: options.Machine = "cmf",  # read by `options.of_machine`, for the other names
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = True,
    begin: Annotated[str | None, choice("cli.facility:BEGIN_STATES", "STATE", _SERVE_HELP)] = None,
    out: options.Out = Path("out/serve"),
) -> None:
    """Run the facility in real time on host frames from the network."""
    from cmf_mj.control.states import State
    from cmf_mj.core.files import plain_path
    from cmf_mj.facility.host.moog import MoogServer
    from cmf_mj.facility.host.stream import unit_doubts
    from cmf_mj.facility.host.udp import UdpReceiver
    from cmf_mj.facility.operation import serve
    from cmf_mj.show import operation as report

    latest_session: Session | None = None  # an interrupt does not lose what was run until then

    def attend(session: Session) -> int:
        nonlocal latest_session
        latest_session = session
        return server.attend(session) if protocol == "moog" else session.rate

    plant, run = cmf_mj.Hexapod(cab, hydraulics), _begin_options(begin or "engaged", noise)
    server: Any
    if protocol == "moog":
        if begin is not None:
            raise InputError(f"begin: {begin!r} is nothing to the protocol moog, which begins off")
        server = MoogServer(port, host=host, host_port=host_port, bind=bind, lockstep=lockstep)
        run |= {"begin": State.OFF, "requests": (), "paced": not lockstep}
    else:
        if lockstep:
            raise InputError("lockstep: is nothing to the protocol cmf")
        server = UdpReceiver(port, host=host, host_port=host_port, bind=bind)
    run["attend"] = attend
    with server as receiver:
        address = "{}:{}".format(*receiver.address)
        with progress_bar(f"serving {address}", seconds=True) as bar:

            def progress(time: float) -> None:
                if time == 0.0:
                    print(f"listening on {address}", flush=True)
                bar(time, seconds)

            try:
                operation = serve(plant, law, receiver.ring, seconds, progress=progress, **run)
            except KeyboardInterrupt:
                if latest_session is not None and latest_session.frame:
                    record = cmf_mj.Record(*latest_session.history(), latest_session.describe())
                    print(f"written: {record.save(plain_path(out, 'record.parquet'))}", flush=True)
                raise
    received, refused = int(receiver.ring.written[0]), receiver.refused
    paths = report.save_operation(operation, out, received, refused)
    tables = [report.account_table(operation, received, refused)]
    if operation.timing is not None:
        tables.append(report.timing_table(operation.timing))
    arrivals = operation.arrivals
    doubts = unit_doubts(arrivals.time, arrivals.values[:, 0], plant.machine)
    show(*tables, *doubts, _end_text(operation), written_text(paths))


@drawing("operate")
def operate_command(
    file: StreamFile,
    rate: FrameRate = None,
    seconds: options.Seconds = None,
    law: options.Law = "velocity",
    machine: options.Machine = "cmf",  # read by `options.of_machine`, for the other names
    cab: options.Cab = "gfd",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = True,
    begin: Annotated[str, choice("cli.facility:BEGIN_STATES", "STATE", _BEGIN_HELP)] = "engaged",
    out: options.Out = Path("out/operate"),
) -> None:
    """Run the facility on a file of host frames, as fast as it goes."""
    from cmf_mj.facility.operation import operate
    from cmf_mj.show import operation as report

    plant = cmf_mj.Hexapod(cab, hydraulics)
    stream = _stream(file, rate, plant.cab_parameters)
    operation = operate(plant, law, stream, seconds=seconds, **_begin_options(begin, noise))
    paths = report.save_operation(operation, out)
    show(report.account_table(operation), _end_text(operation), written_text(paths))


@command("host")
def host_command(
    file: StreamFile,
    to: Annotated[str, Option(metavar="ADDRESS:PORT", help="of the receiver")],
    port: Annotated[int, Option(help="UDP port to send from; 0 takes a free one")] = 0,
    rate: FrameRate = None,
    speed: Annotated[float, Option(help="stamped time over real time: 0.9 is a slow host")] = 1.0,
    jitter: Annotated[float, Option(help="largest random delay of a frame [s]")] = 0.0,
    stutter: Annotated[float, Option(help="pause twice a second [s]")] = 0.0,
    loss: Annotated[float, Option(help="share of frames that are lost")] = 0.0,
) -> None:
    """Send a file of host frames over UDP in real time, or as an overloaded host would."""
    from cmf_mj.facility.host.stream import HostTiming
    from cmf_mj.facility.host.udp import parse_target, send_stream

    target = parse_target(to)
    stream = _stream(file, rate)
    timing = HostTiming(speed, jitter, stutter, loss)
    sent = send_stream(stream, *target, source_port=port, timing=timing)
    show(
        f"{sent.frames} frames in {sent.duration:.3f} s, late by "
        f"{1e3 * sent.mean_lateness:.2f} ms on average, {1e3 * sent.worst_lateness:.2f} at most"
    )


@drawing("replay")
def replay_command(
    recording: Annotated[Path, Argument(help="Parquet or facility CSV")],
    law: options.OtherLaw = None,
    out: options.Out = Path("out/replay"),
) -> None:
    """Run the control law open loop on recorded feedback; compare the compensator's output."""
    from cmf_mj.core.files import plain_path
    from cmf_mj.facility.replay import replay
    from cmf_mj.record.columns import read_mapped
    from cmf_mj.show import operation as report
    from cmf_mj.show.look import save_figure

    record = read_mapped(recording)
    replayed = replay(record, law or None)
    name = f"{recording.stem}_{replayed.law}.png"
    path = save_figure(report.replay_figure(replayed), plain_path(out, name))
    show(report.replay_summary(replayed), f"written: {path}")


@command("export")
def export_command(
    what: Annotated[str, options.argument("cli.facility:EXPORTS", "WHAT", _EXPORTS)],
    plant: options.PlantName = "hexapod",
    machine: options.Machine = "cmf",  # read by `options.of_machine`, for the other names
    cab: options.Cab = "gfd",
    law: options.Law = "velocity",
    hydraulics: options.Hydraulics = "hardware",
    noise: options.Noise = False,
    fmi: Annotated[int, Option(help="version of FMI, 2 or 3")] = 2,
    out: options.Out = Path("out/export"),
) -> None:
    """Leave Python: the machine as a C library or an FMU, or a law alone as C source."""
    from cmf_mj.core.files import plain_path
    from cmf_mj.export.fmu import export_fmu
    from cmf_mj.export.library import export_law, export_library
    from cmf_mj.plant.hexapod import make_plant

    if what == "law":
        return show(written_text(export_law(law, out, cab), out))
    machinery, chain = make_plant(plant, cab, hydraulics), noise_option(noise)
    if what == "library":
        paths = export_library(machinery, law, out, electronics=chain)
    else:
        paths = [export_fmu(machinery, law, plain_path(out, "cmf.fmu"), fmi=fmi, electronics=chain)]
    show(written_text(paths, out))
