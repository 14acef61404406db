"""Hours under load: `python scripts/soak.py studio` and `python scripts/soak.py host`.

`studio`: every period one tab opens and shows its session until the next, and others close while
theirs are still being built; memory, and the time of an interrupt. A tab is a plain websocket
client that reads what it is sent.

`host`: the facility in real time on a host of 80 Hz while another program floods its port with
garbage. What the two send is compared with the account of the run: no good frame may be missing,
and every datagram is in one line of it.
"""

import argparse
import contextlib
import csv
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
import viser
from viser import _messages as messages
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from cmf_mj import Hexapod, signals
from cmf_mj.cli.common import show
from cmf_mj.facility.host.stream import from_command, write_stream
from cmf_mj.facility.host.udp import UdpReceiver
from cmf_mj.facility.operation import Operation, serve
from cmf_mj.show.operation import account_table, save_operation, timing_table

CAMERA = messages.ViewerCameraMessage(
    wxyz=(1.0, 0.0, 0.0, 0.0),
    position=(10.0, -10.0, 2.0),
    fov=0.6,
    near=0.1,
    far=100.0,
    image_height=480,
    image_width=960,
    look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
)
"""What a tab sends first; the studio builds its session then."""

BLOCK = 6
"""Periods of which the median is taken."""


class Soak(NamedTuple):
    """What a soak measured."""

    time: np.ndarray  #: Of each period's end [s], (N,).
    memory: np.ndarray  #: Memory of the studio then, of its own [MB], (N,).
    interrupt: float  #: From SIGINT to the end of the process, a tab being open [s].

    def spread(self, settle: float) -> float:
        """Largest departure from the median after a time [s], as a share of the median.

        Of medians of six periods each: the tab of a period may not be built yet when it ends.
        """
        late = self.memory[self.time >= settle]
        ends = late[: late.size // BLOCK * BLOCK].reshape(-1, BLOCK)
        middle = np.median(late)
        return float(np.abs(np.median(ends, axis=1) - middle).max(initial=0.0) / middle)


def connected(url: str, origin: str | None = None, **headers: str) -> ClientConnection:
    """A websocket to a studio as its page opens it, or with another origin."""
    return connect(
        url.replace("http", "ws", 1),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        origin=Origin(url.partition("/?")[0] if origin is None else origin),
        additional_headers=headers,
        max_size=None,
        compression=None,
    )


def send(tab: ClientConnection, message: Any) -> None:
    """Send one of viser's messages."""
    tab.send(msgspec.msgpack.encode(message.as_serializable_dict()))


def read_until_closed(tab: ClientConnection) -> None:
    """Take what a tab is sent."""
    with contextlib.suppress(ConnectionClosed):
        while True:
            tab.recv()


def own_memory(process: int) -> float:
    """Memory of a process without files, whose pages the system takes as it likes [MB]."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    sizes = (line.split()[1] for line in lines if line.startswith(("RssAnon", "VmSwap")))
    return sum(float(size) / 1024.0 for size in sizes)


def soak(seconds: float, period: float, hurried: int, port: int) -> Soak:
    """Open and close tabs of a studio in a process of its own for some seconds.

    Besides the one that stays, `hurried` tabs open in each period and close within a second.
    """
    command = [sys.executable, "-m", "cmf_mj", "studio", "--no-open", "--port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = next(line for line in process.stdout if line.startswith("studio: "))
            url, begun = line.split()[1], time.monotonic()
            rows: list[tuple[float, float]] = []
            generator = np.random.default_rng(19)
            while (passed := time.monotonic() - begun) < seconds or not rows:
                tabs = [connected(url) for _ in range(1 + hurried)]
                for tab in tabs:
                    send(tab, CAMERA)
                    threading.Thread(target=read_until_closed, args=(tab,), daemon=True).start()
                for tab in tabs[1:]:
                    time.sleep(float(generator.uniform(0.0, 0.5)))
                    tab.close()
                time.sleep(max(begun + passed + period - time.monotonic(), 0.0))
                rows.append((time.monotonic() - begun, own_memory(process.pid)))
                print(f"{rows[-1][0]:8.1f} s {rows[-1][1]:8.1f} MB", flush=True)
                tabs[0].close()
            send(last := connected(url), CAMERA)
            told = time.monotonic()
            process.send_signal(signal.SIGINT)
            process.wait(timeout=60.0)
            taken = time.monotonic() - told
            last.close()
        finally:
            process.kill()
    passed_s, memory = np.array(rows).T
    return Soak(passed_s, memory, taken)


def soak_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.csv")
    parser.add_argument("--seconds", type=float, default=3600.0, help="length")
    parser.add_argument("--period", type=float, default=10.0, help="from tab to tab [s]")
    parser.add_argument("--hurried", type=int, default=3, help="tabs closed while being built")
    parser.add_argument("--settle", type=float, default=600.0, help="left out of the spread [s]")
    parser.add_argument("--port", type=int, default=8472, help="TCP port")


def save_soak(arguments: argparse.Namespace) -> None:
    """Parse the arguments, soak, and write the memory."""
    done = soak(arguments.seconds, arguments.period, arguments.hurried, arguments.port)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    with arguments.out.open("w", newline="") as file:
        csv.writer(file).writerows([("time_s", "memory_mb"), *zip(*done[:2], strict=True)])
    settle = min(arguments.settle, 0.5 * float(done.time[-1]))
    print(f"memory within {100.0 * done.spread(settle):.1f} % of its median after {settle:.0f} s")
    print(f"ended {done.interrupt:.2f} s after SIGINT")


RATE = 80.0
"""Frames of the host in a second [Hz]."""

START = 6.0
"""Time that the host's program has to start [s]."""

GARBAGE = """
import random, socket, sys, time
from cmf_mj.facility.host.udp import SIZE
port, rate, count = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
sender, made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), random.Random(19)
start = time.monotonic()
for number in range(count):
    time.sleep(max(start + number / rate - time.monotonic(), 0.0))
    kind = number % 3
    octets = made.randbytes(SIZE if kind else made.randrange(400))
    sender.sendto(b"CMFH" + octets[4:] if kind == 2 else octets, ("127.0.0.1", port))
"""
"""Octets of any length, of a frame's, and of a frame's behind its magic."""


class Flood(NamedTuple):
    """What was sent, and what became of it."""

    good: int  #: Frames the host sent.
    garbage: int  #: Datagrams the other program sent.
    received: int  #: Frames put into the ring.
    dropped: dict[str, int]  #: Datagrams dropped, by reason.
    operation: Operation  #: The run.


def free_port() -> int:
    """A port that no program has."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        return int(taken.getsockname()[1])


def flood(seconds: float, rate: float) -> Flood:
    """Serve a host for some seconds under a flood of so many datagrams a second."""
    command = signals.sine("heave", 0.05, 0.5, cycles=0.5 * seconds)
    stream = from_command(command, RATE)
    with tempfile.TemporaryDirectory() as folder:
        file = write_stream(stream, Path(folder) / "host.parquet")
        with UdpReceiver(host_port=(source := free_port())) as receiver:
            address, port = receiver.address
            count = round((seconds + START) * rate)
            host = ("-m", "cmf_mj", "host", str(file), "--to", f"{address}:{port}")
            programs: list[subprocess.Popen[bytes]] = []

            def begin(done: float) -> None:
                if not programs:
                    for arguments in (
                        (*host, "--port", str(source)),
                        ("-c", GARBAGE, str(port), str(rate), str(count)),
                    ):
                        programs.append(
                            subprocess.Popen(
                                [sys.executable, *arguments], stdout=subprocess.DEVNULL
                            )
                        )

            operation = serve(Hexapod(), "velocity", receiver.ring, seconds + START, progress=begin)
            if any([program.wait() for program in programs]):
                raise RuntimeError("a program that sends has failed")
        return Flood(stream.time.size, count, receiver.received, receiver.refused, operation)


def flood_options(parser: argparse.ArgumentParser) -> None:
    """Options of the command line."""
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--seconds", type=float, default=600.0, help="length of the stream")
    parser.add_argument("--rate", type=float, default=2000.0, help="garbage datagrams a second")


def save_flood(arguments: argparse.Namespace) -> None:
    """Parse the arguments, run, and print the account."""
    done = flood(arguments.seconds, arguments.rate)
    save_operation(done.operation, arguments.out, done.received, done.dropped)
    show(account_table(done.operation, done.received, done.dropped))
    if done.operation.timing is not None:
        show(timing_table(done.operation.timing))
    sent, counted = done.good + done.garbage, done.received + sum(done.dropped.values())
    print(
        f"sent {done.good} frames and {done.garbage} others; {counted} of {sent} are accounted for"
    )
    print(f"frames of the host received: {done.received} of {done.good}")


def main() -> None:
    """Soak what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    under = parser.add_subparsers(dest="under", required=True)
    soak_options(under.add_parser("studio", help="tabs that open and close"))
    flood_options(under.add_parser("host", help="a host's port under garbage"))
    arguments = parser.parse_args()
    (save_soak if arguments.under == "studio" else save_flood)(arguments)


if __name__ == "__main__":
    main()
