"""The server as `truepath serve` starts it: in a thread, or in a forked process."""

import multiprocessing
import os
import resource
import signal
import socket
import threading
import time
from contextlib import contextmanager
from dataclasses import replace

from truepath import main
from truepath.service.api.application import create_application
from truepath.service.api.server import Server
from truepath.service.page import pages
from truepath.settings import load_settings


@contextmanager
def serving(service, access=None, **options):
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


def serve_forked(settings, log, told, descriptors, prepare):
    """Serve as a process of its own; the address is told. prepare : called before"""
    os.setsid()
    if descriptors is not None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (descriptors, descriptors))
    os.environ.update(settings)
    for number, place in ((1, os.devnull), (2, log)):
        os.dup2(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644), number)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    pages.router.add_api_route("/freeze", _freeze)
    prepare()
    main.serve(load_settings(), listening=told.send)


def end_while_it_starts():
    run = main.Server.run

    def end_at_once(server, sockets):
        os.kill(os.getpid(), signal.SIGTERM)
        run(server, sockets)

    main.Server.run = end_at_once


def hang_at_the_end():
    """Let the jobs' dispatcher never close."""
    main._END_S = 1.0
    main.Dispatcher.close = lambda *_: time.sleep(600.0)


def _end_with_parent():
    multiprocessing.parent_process().join()
    os.kill(os.getpid(), signal.SIGTERM)


async def _freeze():
    """Let the event loop stand still."""
    time.sleep(4.0)
