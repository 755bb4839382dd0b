"""The viewer's server: viser on loopback, behind a check of who asks.

A page of another site that the same browser shows could open a WebSocket to a server on loopback, and a name of another
site could be made to mean 127.0.0.1. viser asks for neither Origin nor Host, so that both are checked here, before
viser sees a request.
"""

from __future__ import annotations

import http
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import rich
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

__all__ = ["HOST", "Server", "open_server", "refusal"]

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")  # by which a browser may name the server

ProcessRequest = Callable[[ServerConnection, Request], Response | None]


class Server(viser.ViserServer):
    """viser's server without its tunnel to a public address, which any client could ask for."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """No address: the garment stays on this machine."""
        return None

    def stop(self) -> None:
        """Close all connections and end the server's threads."""
        with _quietly():
            super().stop()


def open_server(label: str, port: int) -> Server:
    """Start a server on loopback.

    Args:
        label: shown above the controls.
        port: taken if it is free, else the next free one; 0 for any.

    Raises:
        RuntimeError: viser did not take the check.
    """
    with _checked_requests() as taken, _quietly():
        server = Server(host=HOST, port=port, label=label, verbose=False)
    if not taken:
        server.stop()
        raise RuntimeError("viser started a server without the check of its requests")
    return server


def refusal(hosts: list[str], origins: list[str], upgrade: bool, port: int) -> str | None:
    """Why a request is refused; None if it is not.

    Args:
        hosts: values of the request's Host headers.
        origins: values of its Origin headers. A browser sends one with every WebSocket.
        upgrade: whether it asks for a WebSocket.
        port: of the server.
    """
    names = [f"{name}:{port}" for name in NAMES]
    if len(hosts) != 1 or hosts[0] not in names:
        return f"Host must be {' or '.join(names)}"
    wanted = [f"http://{name}" for name in names]
    if any(origin not in wanted for origin in origins) or (upgrade and len(origins) != 1):
        return f"Origin must be {' or '.join(wanted)}"
    return None


@contextmanager
def _quietly() -> Iterator[None]:
    """Viser writes of its start and its end on standard output."""
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = quiet


@contextmanager
def _checked_requests() -> Iterator[list[bool]]:
    """Let servers that are started meanwhile check each request first; the list says whether one was."""
    module: Any = websockets.asyncio.server
    serve, taken = module.serve, []

    def serve_checked(*arguments: Any, process_request: ProcessRequest, **options: Any) -> Any:
        taken.append(True)
        return serve(*arguments, process_request=_after_check(process_request), **options)

    module.serve = serve_checked
    try:
        yield taken
    finally:
        module.serve = serve


def _after_check(process_request: ProcessRequest) -> ProcessRequest:
    def checked(connection: ServerConnection, request: Request) -> Response | None:
        headers = request.headers
        upgrade = any("websocket" in value.lower() for value in headers.get_all("Upgrade"))
        hosts, origins, port = headers.get_all("Host"), headers.get_all("Origin"), connection.local_address[1]
        reason = refusal(hosts, origins, upgrade, port)
        if reason is not None:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"{reason}\n")
        return process_request(connection, request)

    return checked
