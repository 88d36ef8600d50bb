"""Web server of the design page, reachable from this machine only."""

from __future__ import annotations

import hmac
import json
import secrets
import signal
import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Lock, Thread, current_thread, main_thread
from typing import Any
from urllib.parse import parse_qs, urlsplit

from surctl.errors import InputError
from surctl.report.design_bench import DesignBench
from surctl.report.page_parts import page, respond

_HOST = "127.0.0.1"
_LONGEST = 1_000_000  # bytes of a request


def serve(bench: DesignBench, *, port: int | None = None, ready: Callable[[str], None]) -> None:
    """Serve the design page until the process is interrupted.

    Args:
        bench: the closed loop that the page shows.
        port: port of 127.0.0.1; None picks a free port.
        ready: function that is called with the address of the page as soon as the server runs.

    Raises:
        InputError: the port cannot be used.
        KeyboardInterrupt: at Ctrl-C, after the server has closed.
    """
    token = secrets.token_urlsafe(16)  # the page writes files: scripts of other sites must have no access
    try:
        server = _Server((_HOST, port or 0), _handler(bench, token))
    except OSError as error:
        remedy = "omit it to use a free port"
        raise InputError(f"cannot be used ({error.strerror})", key="--port", value=port, remedy=remedy) from None
    with server:
        if current_thread() is main_thread():
            signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may have left it ignored
        Thread(target=ready, args=(f"http://{_HOST}:{server.server_address[1]}/?token={token}",), daemon=True).start()
        server.serve_forever(poll_interval=0.1)


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Report an error, unless the browser has closed the connection."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


def _handler(bench: DesignBench, token: str) -> type[BaseHTTPRequestHandler]:
    lock = Lock()  # numpy and CasADi functions of one system are not shared between threads

    def permitted(secret: str) -> bool:
        return hmac.compare_digest(secret.encode("utf-8", "surrogateescape"), token.encode())

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            parts = urlsplit(self.path)
            secret = parse_qs(parts.query).get("token", [""])[0]
            if parts.path != "/" or not permitted(secret):
                self._send(403 if parts.path == "/" else 404, b"no access", "text/plain")
                return
            with lock:
                text = page(bench, nonce=secrets.token_urlsafe(12), token=token)
            self._send(200, text.encode(), "text/html; charset=utf-8")

        def do_POST(self) -> None:
            stated = self.headers.get("Content-Length", "")
            length = int(stated) if stated.isascii() and stated.isdigit() and len(stated) < 10 else 0
            if not permitted(self.headers.get("X-Token", "")) or not 0 < length <= _LONGEST:
                self.close_connection = True
                self._send(403, b"no access", "text/plain")
                return
            try:
                with lock:
                    reply: Any = respond(bench, self.path.strip("/"), json.loads(self.rfile.read(length)))
                body = json.dumps(reply, allow_nan=False).encode()
            except (InputError, ValueError, RecursionError) as error:
                self._send(400, str(error).encode(), "text/plain")
                return
            self._send(200, body, "application/json")

        def _send(self, status: int, body: bytes, kind: str) -> None:
            self.send_response(status)
            for name, value in (
                ("Content-Type", kind), ("Content-Length", str(len(body))), ("Cache-Control", "no-store"),
                ("X-Content-Type-Options", "nosniff"), ("Referrer-Policy", "no-referrer"),
            ):  # fmt: skip
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            """Write nothing for each request."""

    return Handler
