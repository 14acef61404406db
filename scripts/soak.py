"""The facility in real time under garbage: `python scripts/soak.py --out FOLDER`.

A host of 80 Hz sends its frames while another program floods its port with garbage. What the two
send is compared with the account of the run: no good frame may be missing, and every datagram is
in one line of it.
"""

import argparse
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from cmf_mj import Hexapod, signals
from cmf_mj.cli.common import show
from cmf_mj.facility.host.stream import from_command, write_stream
from cmf_mj.facility.host.udp import UdpReceiver
from cmf_mj.facility.operation import Operation, serve
from cmf_mj.show.operation import account_table, save_operation, timing_table

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
        return Flood(stream.time.size, count, receiver.received_frames, receiver.refused, operation)


def main() -> None:
    """Run under a flood, and print the account."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--seconds", type=float, default=600.0, help="length of the stream")
    parser.add_argument("--rate", type=float, default=2000.0, help="garbage datagrams a second")
    arguments = parser.parse_args()
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


if __name__ == "__main__":
    main()
