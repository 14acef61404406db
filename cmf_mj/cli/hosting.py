"""`cmf host`."""

from typing import Annotated

import typer

from cmf_mj.cli.common import Derivatives, FrameRate, StreamFile, app, refuse, show
from cmf_mj.facility.host.files import read_stream
from cmf_mj.facility.host.stream import resample
from cmf_mj.facility.host.udp import UdpSender, parse_target


@app.command("host")
def host_command(
    file: StreamFile,
    to: Annotated[str, typer.Option(help="ADDRESS:PORT of the receiver")],
    rate: FrameRate = None,
    derivatives: Derivatives = "spline",
) -> None:
    """Send a file of host frames over UDP in real time."""
    try:
        address, port = parse_target(to)
        stream = read_stream(file, derivatives=derivatives)
        with UdpSender(address, port) as sender:
            sent = sender.play(stream if rate is None else resample(stream, rate))
        show(
            f"{sent.frames} frames in {sent.duration:.3f} s, late by "
            f"{1e3 * sent.mean_lateness:.2f} ms on average, {1e3 * sent.worst_lateness:.2f} at most"
        )
    except (ValueError, OSError) as error:
        refuse(error)
