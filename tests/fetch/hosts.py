"""A host of files on this machine, which fails as real ones do.

Other tests use it: ``from fetch.hosts import Host``.
"""

from __future__ import annotations

import hashlib
import re
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


class Host:
    """Serves bytes by path on 127.0.0.1, and remembers what was asked."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files
        self.breaks_after: list[int] = []
        """Bytes after which the next answers break off, one for each answer."""
        self.fails_with: list[int] = []
        """Codes that the next answers have instead of the file, one for each answer."""
        self.has_ranges = True
        self.pause_s = 0.0
        """Pause after each 64 kB."""
        self.asked: list[tuple[str, str]] = []
        """Path and Range of each request."""
        host = self

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                host.answer(self)

            def log_message(self, format: str, *args: Any) -> None:
                """Keep quiet."""

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}"
        self.thread = threading.Thread(target=self.server.serve_forever, daemon=True)
        self.thread.start()

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        span = request.headers.get("Range", "")
        self.asked.append((request.path, span))
        request.close_connection = True
        if self.fails_with:
            request.send_error(self.fails_with.pop(0))
            return
        data = self.files.get(request.path)
        if data is None:
            request.send_error(404)
            return
        tag = f'"{hashlib.sha256(data).hexdigest()[:16]}"'
        start = 0
        if span and self.has_ranges and request.headers.get("If-Range") == tag:
            found = re.fullmatch(r"bytes=(\d+)-", span)
            assert found
            start = int(found[1])
        if start >= len(data) > 0:
            request.send_response(416)
            request.send_header("Content-Range", f"bytes */{len(data)}")
            request.send_header("Content-Length", "0")
            request.end_headers()
            return
        request.send_response(206 if start else 200)
        request.send_header("ETag", tag)
        request.send_header("Content-Length", str(len(data) - start))
        if start:
            request.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
        request.end_headers()
        end = len(data)
        if self.breaks_after:
            end = min(end, start + self.breaks_after.pop(0))
        for at in range(start, end, 1 << 16):
            try:
                request.wfile.write(data[at : min(at + (1 << 16), end)])
            except OSError:  # whoever asked is gone
                return
            time.sleep(self.pause_s)

    def close(self) -> None:
        self.server.shutdown()
        self.server.server_close()
