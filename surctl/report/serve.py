"""Serve the tuning page on this machine alone."""

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
_BENCHES: list[Bench] = []  # the page's cells run in threads of this process, and are given nothing else


def current_bench() -> Bench:
    """The bench of the page that this process serves.

    Raises:
        InputError: none is served.
    """
    if not _BENCHES:
        raise InputError("nothing is served", key="page", remedy="start it with surctl tune --page")
    return _BENCHES[-1]


def serve(bench: Bench, *, port: int | None = None, ready: Callable[[str], None]) -> None:
    """Serve until interrupted.

    Args:
        bench: what is tuned.
        port: of 127.0.0.1; None for a free one.
        ready: told the page's address once the port is taken.

    Raises:
        ToolMissing: marimo is not installed.
        InputError: the port is taken.
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
            f"cannot be used ({error.strerror})", key="--port", value=port, remedy="leave it away for a free one"
        ) from None
    _BENCHES.append(bench)
    page = str(Path(__file__).with_name("tuning_page.py"))
    key = secrets.token_urlsafe(16)  # the page writes files: another site's script must not reach it
    app = marimo.create_asgi_app(quiet=True, token=key).with_app(path="", root=page).build()
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", timeout_graceful_shutdown=1))
    with door:
        address = f"http://{_HOST}:{door.getsockname()[1]}/?access_token={key}"
        if asyncio.run(_run(server, door, lambda: ready(address))):
            raise KeyboardInterrupt


async def _run(server: Any, door: socket.socket, ready: Callable[[], None]) -> bool:
    """Serve until a signal; whether it was Ctrl-C, which marimo would otherwise ask about."""
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        stopped = server.should_exit = True

    serving = asyncio.create_task(server.serve(sockets=[door]))
    while not (server.started or serving.done()):
        await asyncio.sleep(0.02)
    with suppress(NotImplementedError):  # Windows has none
        asyncio.get_running_loop().remove_signal_handler(signal.SIGINT)
    signal.signal(signal.SIGINT, stop)
    ready()
    await serving
    return stopped
