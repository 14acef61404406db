"""Accounts, tables, figures and files of runs; `cmf operate`; `cmf serve` against `cmf host`."""

import csv
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from shared import cmf

from cmf_mj import Hexapod, Record, signals
from cmf_mj.facility.host.stream import HostStream, from_command, read_arrivals, write_stream
from cmf_mj.facility.host.stream import arrivals as arrivals_of
from cmf_mj.facility.operation import Operation, Timing, account, operate
from cmf_mj.show import operation as operation_report


def stream(seconds: float) -> HostStream:
    command = signals.sine("heave", 0.02, 0.5, cycles=0.5 * seconds)
    return from_command(command, rate=80.0)


@pytest.fixture(scope="module")
def run() -> Operation:
    arrivals = arrivals_of(stream(1.0))
    arrivals.values[40, 1, 2] = np.nan
    return operate(Hexapod(), "velocity", arrivals)


TIMING = Timing(
    np.concatenate([np.full(998, 40e-6), [600e-6, 900e-6]]),
    np.concatenate([np.full(999, 1e-6), [2e-3]]),
)


def test_every_frame_is_in_one_line_of_the_account(run: Operation) -> None:
    arrived = run.arrivals.frame.size
    plain = account(run)
    assert plain["received"] == arrived
    assert plain["not_finite"] == 1
    assert plain["accepted"] == arrived - 1 - plain["waiting"]
    live = run._replace(unused={"early": 3, "lost": 2})
    datagrams = {"wrong_sender": 7}
    counts = account(live, arrived + 9, datagrams)
    dropped = ("early", "lost", "after_end", "wrong_sender")
    assert [counts[name] for name in dropped] == [3, 2, 4, 7]
    parts = ("early", "lost", "after_end", "accepted", "waiting", *run.rejections)
    assert sum(counts[name] for name in parts) == counts["received"]


def test_timing_is_told_in_the_terms_of_the_frame() -> None:
    rows = dict(operation_report.timing_table(TIMING).cells)
    assert rows["50 % of frames below"] == "40.0 us"
    assert rows["largest"] == "900.0 us"
    assert rows["over 488 us of computing"] == "2 of 1000"
    assert rows["largest lateness"] == "2.000 ms"
    assert rows["begun more than a frame late"] == "1 of 1000"
    assert float(rows["99.9 % of frames below"].split()[0]) == pytest.approx(600.3, abs=0.1)


def test_files_of_a_run_in_real_time(
    run: Operation, tmp_path: Path, drawn: dict[str, set[str]]
) -> None:
    paths = operation_report.save_operation(run._replace(timing=TIMING), tmp_path)
    expected = "record.parquet host.parquet account.csv operation.png timing.csv"
    assert [path.name for path in paths] == expected.split()
    record = Record.load(paths[0])
    assert record["leg_reference"].tobytes() == run.record["leg_reference"].tobytes()
    for written, arrived in zip(read_arrivals(paths[1]), run.arrivals, strict=True):
        np.testing.assert_array_equal(written, arrived)
    with paths[2].open(newline="") as file:
        counts = dict(list(csv.reader(file))[1:])
    assert counts == {n: str(c) for n, c in account(run).items()}
    assert "largest,900.0 us" in paths[4].read_text()
    assert set(drawn) == {"operation.png"}


def test_cmf_operate(tmp_path: Path) -> None:
    path = write_stream(stream(1.0), tmp_path / "flight.csv")
    out = tmp_path / "out"
    assert "ended engaged, no fault" in cmf("operate", path, "--out", out)
    record = Record.load(out / "record.parquet")
    assert record.metadata["electronics"]["sensors"]["name"] == "noisy"
    wrong = cmf("operate", path, "--begin", "flying", "--out", out, code=2)
    assert "begin: 'flying' is not one of engaged, settled" in wrong


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["cmf", "moog"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interrupt_of_cmf_serve_keeps_the_record(
    protocol: str, number: signal.Signals, tmp_path: Path
) -> None:
    """What was run until then, at the rate of a record in real time, 128 Hz."""
    line = [sys.executable, "-m", "cmf_mj", "serve", "--protocol", protocol, "--port", "0"]
    with subprocess.Popen(
        [*line, "--seconds", "600", "--out", str(tmp_path / "served")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as server:
        assert server.stdout is not None
        assert server.stdout.readline().startswith("listening on")
        time.sleep(4.0)
        server.send_signal(number)
        printed, complaint = server.communicate(timeout=120.0)
    assert server.returncode == 130, complaint
    assert "written: " in printed and "record.parquet" in printed
    record = Record.load(tmp_path / "served" / "record.parquet")
    assert record.rate == 128.0
    assert 1.0 < record.time[-1] < 60.0
    assert np.isfinite(record["leg_position"]).all()


@pytest.mark.slow
def test_cmf_serve_against_cmf_host_accounts_for_every_frame(tmp_path: Path) -> None:
    """Two processes on loopback; a stranger and garbage between. Counts only, no times."""
    path = write_stream(stream(2.0), tmp_path / "flight.csv")
    out = tmp_path / "served"
    command = [sys.executable, "-m", "cmf_mj"]
    environment = os.environ | {"COLUMNS": "200"}
    with subprocess.Popen(
        [*command, "serve", "--port", "0", "--seconds", "24", "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as server:
        assert server.stdout is not None and server.stderr is not None
        first = server.stdout.readline()
        assert first.startswith("listening on 127.0.0.1:"), first + server.stderr.read()
        port = int(first.rsplit(":", 1)[1])
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as garbage:
            for data in (b"", b"garbage", bytes(172), bytes(500)):
                garbage.sendto(data, ("127.0.0.1", port))
        sender = subprocess.run(
            [*command, "host", str(path), "--to", f"127.0.0.1:{port}"],
            capture_output=True,
            text=True,
            check=True,
        )
        printed, complaint = server.communicate()
    assert server.returncode == 0, complaint
    sent = int(sender.stdout.split()[0])
    with (out / "account.csv").open(newline="") as file:
        counts = {name: int(count) for name, count in list(csv.reader(file))[1:]}
    assert sent == stream(2.0).time.size == counts["received"]
    refused = sum(
        counts[reason] for reason in Record.load(out / "record.parquet").metadata["host_rejections"]
    )
    assert counts["accepted"] + refused + counts["waiting"] + counts["lost"] == sent
    assert counts["early"] == counts["after_end"] == 0
    assert counts["accepted"] > 0.8 * sent
    assert (counts["wrong_length"], counts["wrong_magic"]) == (3, 1)
    assert "99.9 % of frames below" in printed
    assert "host_watchdog" in printed
    assert "99.9 % of frames below" in (out / "timing.csv").read_text()
