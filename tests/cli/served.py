"""Something that answers as a daemon would, once."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

from tests.daemon.waiting import LIMIT


@contextmanager
def serving_once(page: bytes) -> Iterator[str]:
    """Yield the address at which one request is answered with a page."""

    class Served(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Served) as server:
        server.timeout = LIMIT
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            thread.join()
