"""The viewer's server answers browsers of this machine that show its own page, and nobody else."""

from __future__ import annotations

import http.client
from collections.abc import Iterator

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from runtime.viewer.server import Server, open_server, refusal

PROTOCOL = f"viser-v{viser.__version__}"


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    server = open_server("test", 0)
    yield server
    server.stop()


def status(server: Server, path: str = "/", **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=5)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in {"Host": f"127.0.0.1:{server.get_port()}", **headers}.items():
        connection.putheader(name, value)
    connection.endheaders()
    try:
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("hosts", "origins", "upgrade", "refused"),
    [
        (["127.0.0.1:80"], [], False, False),
        (["localhost:80"], ["http://localhost:80"], True, False),
        (["127.0.0.1:80"], ["http://127.0.0.1:80"], True, False),
        (["127.0.0.1:80"], [], True, True),  # a browser says where a WebSocket comes from
        (["127.0.0.1:80"], ["http://evil.example"], True, True),
        (["127.0.0.1:80"], ["http://evil.example"], False, True),
        (["127.0.0.1:80"], ["http://127.0.0.1:81"], True, True),
        (["127.0.0.1:80"], ["https://127.0.0.1:80"], True, True),
        (["127.0.0.1:80"], ["null"], True, True),
        (["127.0.0.1:80"], ["http://127.0.0.1:80.evil.example"], True, True),
        (["127.0.0.1:80"], ["http://127.0.0.1:80", "http://evil.example"], True, True),
        (["evil.example:80"], [], False, True),  # a name that was made to mean this machine
        (["evil.example:80"], ["http://evil.example:80"], True, True),
        (["127.0.0.1"], [], False, True),
        ([], [], False, True),
        (["127.0.0.1:80", "evil.example"], [], False, True),
    ],
)
def test_who_is_refused(hosts: list[str], origins: list[str], upgrade: bool, refused: bool) -> None:
    assert (refusal(hosts, origins, upgrade, 80) is not None) == refused


def test_it_listens_on_loopback_alone(server: Server) -> None:
    assert server.get_host() == "127.0.0.1"


def test_its_page_is_served_to_its_own_name(server: Server) -> None:
    assert status(server) == 200
    assert status(server, Host=f"localhost:{server.get_port()}") == 200
    assert status(server, Host="evil.example") == 403
    assert status(server, Origin="http://evil.example") == 403


@pytest.mark.parametrize("path", ["/../pyproject.toml", "/%2e%2e/%2e%2e/__init__.py", "/..%5c..%5c__init__.py"])
def test_no_file_outside_its_page_is_served(server: Server, path: str) -> None:
    assert status(server, path) == 404


@pytest.mark.parametrize("origin", ["http://evil.example", "null", None])
def test_a_websocket_of_another_origin_is_refused(server: Server, origin: str | None) -> None:
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://127.0.0.1:{server.get_port()}", origin=origin, subprotocols=[PROTOCOL])
    assert refused.value.response.status_code == 403


def test_a_websocket_of_its_own_page_is_taken(server: Server) -> None:
    port = server.get_port()
    with connect(f"ws://127.0.0.1:{port}", origin=f"http://127.0.0.1:{port}", subprotocols=[PROTOCOL]) as client:
        assert isinstance(client.recv(timeout=5), bytes)


def test_no_client_can_ask_for_a_public_address(server: Server) -> None:
    assert server.request_share_url() is None


def test_a_second_server_takes_another_port(server: Server) -> None:
    other = open_server("other", server.get_port())
    try:
        assert other.get_port() > server.get_port()
    finally:
        other.stop()
