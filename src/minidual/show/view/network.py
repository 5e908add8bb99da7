"""Port and address of a view."""

from __future__ import annotations

import errno
import getpass
import ipaddress
import socket

from minidual.errors import UsageError

PORTS_TRIED = 50


def free_port(host: str, first: int, tries: int = PORTS_TRIED) -> int:
    """Return the first bindable port.

    Raises:
        UsageError: Unusable interface, or no free port.
    """
    last = min(first + tries, 65536) - 1
    for port in range(first, last + 1):
        try:
            for family, kind, protocol, _, address in socket.getaddrinfo(host, port, type=socket.SOCK_STREAM):
                with socket.socket(family, kind, protocol) as probe:
                    probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                    probe.bind(address)
            return port
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise UsageError(
                    f"the view cannot bind interface '{host}', port {port}: {error.strerror or error}",
                    remedy="--view-host 127.0.0.1 for this machine only, and a --view-port from 1024 up",
                ) from error
    raise UsageError(
        f"no free port for the view among {first} to {last}", remedy="end the program that holds them, or --view-port N"
    )


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def url(host: str, port: int) -> str:
    """Return the address to open on this machine."""
    shown = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, f"[{host}]" if ":" in host else host)
    return f"http://{shown}:{port}"


def tunnel_command(port: int) -> str:
    """Return the ssh command for access from another machine."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container without a passwd entry for this user
        user = "user"
    return f"ssh -L {port}:127.0.0.1:{port} {user}@{socket.gethostname()}"
