"""Where the service listens, and the address it tells people."""

import socket
from urllib.parse import urlsplit

import pytest

from truepath.errors import BadInput
from truepath.service.api.server import bind_socket, format_address


@pytest.mark.parametrize(
    ("host", "shown"),
    [
        ("127.0.0.1", "http://127.0.0.1:"),
        ("0.0.0.0", "http://127.0.0.1:"),
        ("::1", "http://[::1]:"),
        ("::", "http://[::1]:"),
    ],
)
def test_the_address_is_one_that_this_computer_can_open(host, shown):
    with bind_socket(host, 0) as listener:
        port = listener.getsockname()[1]
        assert format_address(listener) == f"{shown}{port}"
        place = urlsplit(format_address(listener))
        socket.create_connection((place.hostname, place.port), timeout=5.0).close()


def test_a_port_that_is_taken_is_bad_input_that_names_it():
    with bind_socket("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        with (
            pytest.raises(BadInput, match=f"port {port}: .*; stop what listens there"),
            bind_socket("127.0.0.1", port),
        ):
            pass
