"""A server of the playground, for browsers on this machine only.

It listens at 127.0.0.1, and answers only requests whose host is this address or localhost. So a
page from another host gets no answer, even if the host's name leads to this machine. The server
sends files of a few folders, but no lists of files.
"""

import os
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import SHUT_RDWR
from threading import Lock
from typing import Any
from urllib.parse import unquote, urlsplit

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")  # names of this machine in a browser
CONNECTIONS = 64  # maximum connections; a browser opens six
FIRST_PAGE = "playground.html"
KINDS = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".wasm": "application/wasm",
}
ALWAYS = {
    "Cache-Control": "no-cache",
    "Content-Security-Policy": "script-src 'self' 'wasm-unsafe-eval'; object-src 'none'; "
    "base-uri 'none'; frame-ancestors 'self'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
}
IDLE = 60.0  # [s] idle time before a connection is closed


class Server(ThreadingHTTPServer):
    """A server of the files in several folders.

    Args:
        folders: folders in which the server searches for a file, from first to last.
        port: port of the server. If 0, the server takes any free port.
        prepare: function called with a file's name, e.g. `sort.wasm`, before the search. The
            function may write this file.
    """

    daemon_threads = True  # an open connection does not delay the end
    request_queue_size = CONNECTIONS
    allow_reuse_address = os.name != "nt"  # on Windows it would share a used port

    def __init__(
        self, folders: Sequence[Path], port: int = 0, prepare: Callable[[str], None] | None = None
    ) -> None:
        self._folders = [each.resolve() for each in folders]
        self._prepare = prepare
        self._open: dict[Any, None] = {}  # connections, the oldest first
        self._lock = Lock()
        if not 0 <= port < 2**16:
            raise ValueError(f"port must be from 0 to 65535, got {port}")
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise ValueError(
                f"port must be one that is free, or 0 for any such, got {port} "
                f"({error.strerror or error})"
            ) from None

    def add(self, folder: Path) -> None:
        """Serve the files of another folder."""
        self._folders.append(folder.resolve())

    @property
    def address(self) -> str:
        """Address of the server, with a slash at its end."""
        return f"http://{HOST}:{self.server_port}/"

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer a connection in a thread; if too many connections are open, close the oldest."""
        with self._lock:
            if len(self._open) >= CONNECTIONS:
                oldest = next(iter(self._open))
                del self._open[oldest]
                with suppress(OSError):  # its thread sees the end, and closes it
                    oldest.shutdown(SHUT_RDWR)
            self._open[request] = None
        super().process_request(request, client_address)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer the requests of a connection until the connection is closed."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._lock:
                self._open.pop(request, None)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print the current error, unless a browser only closed its connection."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)

    def find(self, path: str) -> Path | None:
        """Return the file for a path, e.g. `/playground.js`, or None if no folder has it."""
        name = unquote(path).lstrip("/")
        if self._prepare is not None:
            self._prepare(name)
        for folder in self._folders:
            try:
                file = (folder / name).resolve()
                if file.is_relative_to(folder) and file.is_file():
                    return file
            except (OSError, ValueError):  # invalid file name
                return None
        return None


class _Handler(SimpleHTTPRequestHandler):
    """Handler of a browser's requests. It sends files, but no lists of a folder's files."""

    server: Server
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "surface_gym", ""
    extensions_map = KINDS
    timeout = IDLE

    def send_head(self) -> Any:
        """Answer with a file's headers, and return the open file. After an error, return None."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or not _is_here(hosts[0]):
            self.send_error(HTTPStatus.FORBIDDEN, f"Only {' and '.join(NAMES)} are answered")
            return None
        if self.path.partition("?")[0] != "/":
            # Always the whole file: at the next start another folder may have an older one.
            del self.headers["If-Modified-Since"]
            return super().send_head()
        self.send_response(HTTPStatus.FOUND)
        self.send_header("Location", f"/{FIRST_PAGE}")
        self.send_header("Content-Length", "0")
        self.end_headers()
        return None

    def translate_path(self, path: str) -> str:
        """Return the file for a requested path. If no file fits, return the invalid path ""."""
        try:
            return str(self.server.find(urlsplit(path).path) or "")
        except ValueError:
            return ""

    def end_headers(self) -> None:
        """Add the headers `ALWAYS` to every answer, also to an error, and end the headers."""
        for name, value in ALWAYS.items():
            self.send_header(name, value)
        super().end_headers()

    def log_message(self, *_: Any) -> None:
        """Write no log."""


def _is_here(host: str) -> bool:
    """Return whether a request's Host is one of `NAMES`, with or without a port."""
    return re.fullmatch(rf"({'|'.join(map(re.escape, NAMES))})(:[0-9]+)?", host.lower()) is not None
