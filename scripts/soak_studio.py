"""Soak of the studio: tabs that open and close for hours, memory, and the time of an interrupt.

Every period one tab opens and shows its session until the next, and others close while theirs are
still being built. A tab is a plain websocket client that reads what it is sent.
"""

import argparse
import contextlib
import csv
import signal
import subprocess
import sys
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


def main() -> None:
    """Parse the arguments, soak, and write the memory."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.csv")
    parser.add_argument("--seconds", type=float, default=3600.0, help="length")
    parser.add_argument("--period", type=float, default=10.0, help="from tab to tab [s]")
    parser.add_argument("--hurried", type=int, default=3, help="tabs closed while being built")
    parser.add_argument("--settle", type=float, default=600.0, help="left out of the spread [s]")
    parser.add_argument("--port", type=int, default=8472, help="TCP port")
    arguments = parser.parse_args()
    done = soak(arguments.seconds, arguments.period, arguments.hurried, arguments.port)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    with arguments.out.open("w", newline="") as file:
        csv.writer(file).writerows([("time_s", "memory_mb"), *zip(*done[:2], strict=True)])
    settle = min(arguments.settle, 0.5 * float(done.time[-1]))
    print(f"memory within {100.0 * done.spread(settle):.1f} % of its median after {settle:.0f} s")
    print(f"ended {done.interrupt:.2f} s after SIGINT")


if __name__ == "__main__":
    main()
