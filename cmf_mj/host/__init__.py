"""Hosts: platform pose, velocity and acceleration from arrays, files and the network."""

from cmf_mj.host.datagram import DATAGRAM_REASONS, LAYOUT, DatagramError, decode, encode
from cmf_mj.host.files import HostSession, read_stream, write_stream
from cmf_mj.host.handover import NEVER, Ring, collect, logged, make_log, make_ring, put
from cmf_mj.host.interface import (
    MOST_RATE,
    AircraftHost,
    PilotSample,
    PlatformHost,
    host_stream,
    pilot_motion,
    pilot_samples,
)
from cmf_mj.host.stream import (
    HostFrame,
    HostStream,
    arrivals,
    differentiate,
    from_command,
    make_stream,
    resample,
)
from cmf_mj.host.udp import SendReport, UdpReceiver, UdpSender, parse_target

__all__ = [
    "DATAGRAM_REASONS",
    "LAYOUT",
    "MOST_RATE",
    "NEVER",
    "AircraftHost",
    "DatagramError",
    "HostFrame",
    "HostSession",
    "HostStream",
    "PilotSample",
    "PlatformHost",
    "Ring",
    "SendReport",
    "UdpReceiver",
    "UdpSender",
    "arrivals",
    "collect",
    "decode",
    "differentiate",
    "encode",
    "from_command",
    "host_stream",
    "logged",
    "make_log",
    "make_ring",
    "make_stream",
    "parse_target",
    "pilot_motion",
    "pilot_samples",
    "put",
    "read_stream",
    "resample",
    "write_stream",
]
