"""Hosts: platform pose, velocity and acceleration from arrays, files and the network."""

from cmf_mj.facility.host.datagram import DATAGRAM_REASONS, LAYOUT, DatagramError, decode, encode
from cmf_mj.facility.host.files import HostSession, read_stream, write_stream
from cmf_mj.facility.host.handover import NEVER, Ring, collect, logged, make_log, make_ring, put
from cmf_mj.facility.host.stream import (
    HostFrame,
    HostStream,
    arrivals,
    differentiate,
    from_command,
    make_stream,
    resample,
)
from cmf_mj.facility.host.udp import SendReport, UdpReceiver, UdpSender, parse_target

__all__ = [
    "DATAGRAM_REASONS",
    "LAYOUT",
    "NEVER",
    "DatagramError",
    "HostFrame",
    "HostSession",
    "HostStream",
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
    "logged",
    "make_log",
    "make_ring",
    "make_stream",
    "parse_target",
    "put",
    "read_stream",
    "resample",
    "write_stream",
]
