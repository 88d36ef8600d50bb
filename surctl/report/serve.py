"""Web server for the tuning page, reachable from this machine only."""

from __future__ import annotations

import asyncio
import secrets
import signal
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from surctl.errors import InputError, ToolMissing
from surctl.report.bench import Bench

__all__ = ["current_bench", "serve"]

_HOST = "127.0.0.1"
_BENCHES: list[Bench] = []  # the page's cells run in threads of this process and take no arguments


def current_bench() -> Bench:
    """Return the `Bench` (vehicle, scenario, goals) of the tuning page that this process serves.

    Raises:
        InputError: this process does not serve a tuning page.
    """
    if not _BENCHES:
        raise InputError("no tuning page is served", key="page", remedy="start it with surctl tune --page")
    return _BENCHES[-1]


def serve(bench: Bench, *, port: int | None = None, ready: Callable[[str], None]) -> None:
    """Serve the tuning page until the process is interrupted.

    Args:
        bench: vehicle, scenario and goals that the page shows.
        port: port of 127.0.0.1; None picks a free port.
        ready: function that is called with the address of the page as soon as the server runs.

    Raises:
        ToolMissing: marimo is not installed.
        InputError: the port cannot be used.
        KeyboardInterrupt: at Ctrl-C, after the server has closed.
    """
    try:
        import marimo
        import uvicorn
    except ImportError:
        remedy = 'pip install "surctl[notebooks]"'
        raise ToolMissing("the tuning page needs marimo, which is not installed", remedy=remedy) from None
    door = socket.socket()
    try:
        door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        door.bind((_HOST, port or 0))
    except OSError as error:
        door.close()
        raise InputError(
            f"cannot be used ({error.strerror})", key="--port", value=port, remedy="omit it to use a free port"
        ) from None
    _BENCHES.append(bench)
    page = str(Path(__file__).with_name("tuning_page.py"))
    key = secrets.token_urlsafe(16)  # the page writes files: scripts of other sites must have no access
    app = marimo.create_asgi_app(quiet=True, token=key).with_app(path="", root=page).build()
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", timeout_graceful_shutdown=1))
    with door:
        address = f"http://{_HOST}:{door.getsockname()[1]}/?access_token={key}"
        if asyncio.run(_run(server, door, lambda: ready(address))):
            raise KeyboardInterrupt


async def _run(server: Any, door: socket.socket, ready: Callable[[], None]) -> bool:
    # returns whether Ctrl-C ended the server; without this handler marimo would ask the user
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = server.should_exit = True

    serving = asyncio.create_task(server.serve(sockets=[door]))
    while not (server.started or serving.done()):
        await asyncio.sleep(0.02)
    with suppress(NotImplementedError):  # not available on Windows
        asyncio.get_running_loop().remove_signal_handler(signal.SIGINT)
    signal.signal(signal.SIGINT, stop)
    ready()
    await serving
    return stopped
