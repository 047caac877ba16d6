"""The server as `truepath serve` starts it, in a thread, on a real socket."""

from __future__ import annotations

import socket
import threading
from contextlib import contextmanager
from dataclasses import replace

from truepath.service.api.application import create_application
from truepath.service.api.server import Server


@contextmanager
def serving(service, access=None, **options):
    """Yield host and port."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = listener.getsockname()
        app = create_application(replace(service, access=access or service.access))
        server = Server(app, service, "", None, **options)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            yield place
        finally:
            server.should_exit = True
            thread.join(10)
