"""`cmf serve` and `cmf operate`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cmf_mj.cli.common import (
    TEXT_WIDTH,
    Cab,
    Derivatives,
    FrameRate,
    HydraulicSet,
    LawName,
    Noise,
    StreamFile,
    app,
    noise_choice,
    refuse,
    show,
    written,
)
from cmf_mj.control.states import Request, State
from cmf_mj.core.errors import InputError
from cmf_mj.facility.host.files import read_stream
from cmf_mj.facility.host.stream import resample
from cmf_mj.facility.host.udp import UdpReceiver
from cmf_mj.facility.operation import FacilitySettings, Operation, operate, serve
from cmf_mj.plant.hexapod import Hexapod
from cmf_mj.show import operation as operation_report

_BEGIN = {"settled": State.OFF, "engaged": State.ENGAGED}

Begin = Annotated[
    str, typer.Option(help="engaged, or settled: off on the stops, raised and engaged at once")
]


def _begin(name: str) -> tuple[State, list[tuple[float, Request]]]:
    """State to begin in, and the operator's requests."""
    if name not in _BEGIN:
        raise InputError(f"begin: {name!r} is not one of {', '.join(_BEGIN)}")
    return _BEGIN[name], [(0.0, Request.ENGAGE)]


def _told(operation: Operation) -> str:
    """End of the run in a sentence."""
    record = operation.record
    state = State(int(record["operating_state"][-1])).name.lower()
    fault = record.metadata["fault"]
    if fault is None:
        return f"ended {state}, no fault"
    where = "" if fault["leg"] is None else f" of leg {fault['leg']}"
    return f"ended {state}: {fault['name']}{where} at {fault['time']:.3f} s"


@app.command("serve")
def serve_command(
    port: Annotated[int, typer.Option(help="UDP port; 0 takes a free one")] = 2048,
    bind: Annotated[str, typer.Option(help="IPv4 address to listen on")] = "127.0.0.1",
    host: Annotated[str, typer.Option(help="the only host whose datagrams are taken")] = (
        "127.0.0.1"
    ),
    seconds: Annotated[float, typer.Option(help="length of the run")] = 60.0,
    law: LawName = "velocity",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    noise: Noise = True,
    begin: Begin = "engaged",
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/serve"),
) -> None:
    """Run the facility in real time on host frames from the network."""
    try:
        state, requests = _begin(begin)
        plant = Hexapod(cab, hydraulics)
        facility = FacilitySettings(electronics=noise_choice(noise))
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        with (
            UdpReceiver(port, host=host, bind=bind) as receiver,
            Progress(*columns, console=Console(stderr=True)) as bar,
        ):
            where = "{}:{}".format(*receiver.address)
            task = bar.add_task("compiling", total=None)

            def progress(done: float) -> None:
                if done == 0.0:
                    print(f"listening on {where}", flush=True)
                bar.update(task, completed=done, total=seconds, description=f"serving {where}")

            operation = serve(
                plant,
                law,
                receiver.ring,
                seconds,
                begin=state,
                requests=requests,
                facility=facility,
                progress=progress,
            )
        received, refused = receiver.received, receiver.refused
        paths = operation_report.save_operation(operation, out, received, refused)
        tables = [operation_report.account_table(operation, received, refused)]
        if operation.timing is not None:
            tables.append(operation_report.timing_table(operation.timing))
        show(*tables, _told(operation), written(paths), width=TEXT_WIDTH)
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)


@app.command("operate")
def operate_command(
    file: StreamFile,
    rate: FrameRate = None,
    derivatives: Derivatives = "spline",
    seconds: Annotated[
        float | None, typer.Option(help="length of the run; default until the last frame's turn")
    ] = None,
    law: LawName = "velocity",
    cab: Cab = "gfd",
    hydraulics: HydraulicSet = "hardware",
    noise: Noise = True,
    begin: Begin = "engaged",
    out: Annotated[Path, typer.Option(help="folder for results")] = Path("out/operate"),
) -> None:
    """Run the facility on a file of host frames, as fast as it goes."""
    try:
        state, requests = _begin(begin)
        stream = read_stream(file, derivatives=derivatives)
        operation = operate(
            Hexapod(cab, hydraulics),
            law,
            stream if rate is None else resample(stream, rate),
            seconds=seconds,
            begin=state,
            requests=requests,
            facility=FacilitySettings(electronics=noise_choice(noise)),
        )
        paths = operation_report.save_operation(operation, out)
        show(
            operation_report.account_table(operation),
            _told(operation),
            written(paths),
            width=TEXT_WIDTH,
        )
    except (ValueError, OSError, FloatingPointError) as error:
        refuse(error)
