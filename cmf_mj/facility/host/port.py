"""UDP ports at which a machine hears its host, and checks of their addresses and numbers."""

import contextlib
import errno
import socket
import sys
from typing import NamedTuple, Self

from cmf_mj.core.errors import InputError

LOOPBACK = "127.0.0.1"  #: Address at which a machine reaches itself, and nobody else does.

_BUFFER = 4 * 2**20
"""Octets of the system's buffer asked for: some thousand datagrams, seconds of a flood."""
_FORCE_BUFFER = 33  #: SO_RCVBUFFORCE of Linux.


class Datagram(NamedTuple):
    """What came to a port."""

    data: bytes
    sender: tuple[str, int]  #: Address and port.
    is_from_host: bool


class HostPort:
    """A UDP socket that knows its host from other senders. A context manager."""

    def __init__(self, port: int, host: str, host_port: int | None, bind: str, wait: float) -> None:
        """Open it at `bind`, for a host's address and port, None for any; `receive` waits [s]."""
        if host_port is not None:
            check_port("host_port", host_port, 1)
        check_address("host", host)
        self._host, self._host_port, self._socket = host, host_port, open_socket(port, bind)
        self._socket.settimeout(wait)

    @property
    def address(self) -> tuple[str, int]:
        """Address and port it listens on."""
        address, port = self._socket.getsockname()
        return address, port

    def receive(self, octets: int) -> Datagram:
        """The next datagram, of which at most some octets are kept; `OSError` if none comes."""
        data, (address, port) = self._socket.recvfrom(octets)
        is_from_host = address == self._host and self._host_port in (None, port)
        return Datagram(data, (address, port), is_from_host)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def __enter__(self) -> Self:
        """Return the open port."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()


def open_socket(port: int, bind: str) -> socket.socket:
    """A UDP socket at an IPv4 address and port, 0 for a free one; `OSError` for one in use."""
    check_port("port", port, 0)
    check_address("bind", bind)
    udp_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with contextlib.suppress(OSError):  # as much as the system and our rights allow
        udp_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        if sys.platform == "linux":
            udp_socket.setsockopt(socket.SOL_SOCKET, _FORCE_BUFFER, _BUFFER)
    try:
        udp_socket.bind((bind, port))
    except OSError as error:
        udp_socket.close()
        if error.errno == errno.EADDRNOTAVAIL:
            text = f"bind: {bind!r} is no address of this machine"
            raise InputError(f"{text}; allowed: one of its own, or 0.0.0.0") from None
        raise
    return udp_socket


def check_port(name: str, port: int, least: int) -> None:
    """Refuse what is no port; `least` is 0 where that takes a free one."""
    if not least <= port <= 65535:
        raise InputError(f"{name}: {port} is refused; allowed: {least} to 65535")


def check_address(name: str, address: str) -> None:
    """Refuse what is no IPv4 address."""
    try:
        socket.inet_pton(socket.AF_INET, address)
    except OSError as error:
        raise InputError(f"{name}: {address!r} is not an IPv4 address") from error
