"""A headless Chromium, driven by its DevTools protocol over a WebSocket.

Source: https://chromedevtools.github.io/devtools-protocol/.
"""

import base64
import json
import shutil
import subprocess
import time
from contextlib import contextmanager

import pytest
from websockets.sync.client import connect

from tests.daemon.waiting import LIMIT

OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-extensions",
    "--hide-scrollbars",
    "--disable-background-networking",
    "--no-proxy-server",
    "--remote-debugging-port=0",
)


class Tab:
    """One page."""

    def __init__(self, socket):
        self._socket = socket
        self._number = 0
        self.errors = []
        """What the console said at the level of an error, and exceptions nobody caught."""
        for domain in ("Runtime", "Log", "Page", "Network"):
            self.ask(f"{domain}.enable")

    def ask(self, method, **parameters):
        """Call a method; return its result."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=LIMIT))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _note(self, message):
        detail = message.get("params", {})
        match message.get("method"):
            case "Runtime.exceptionThrown":
                self.errors.append(detail["exceptionDetails"])
            case "Runtime.consoleAPICalled" if detail["type"] in ("error", "assert"):
                self.errors.append(detail["args"])
            case "Log.entryAdded" if detail["entry"]["level"] == "error":
                self.errors.append(detail["entry"])

    def open(self, url):
        self.ask("Page.navigate", url=url)

    def show(self, width, height, *, dark=False, phone=False):
        """Be a screen of this size, CSS pixels, and of this taste."""
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=2 if phone else 1,
            mobile=phone,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.ask("Emulation.setEmulatedMedia", features=[scheme])

    def value(self, expression):
        """Return the value of an expression of JavaScript."""
        result = self.ask("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def text(self, selector):
        return self.value(f"document.querySelector({json.dumps(selector)})?.textContent")

    def wait_for(self, expression, seconds=LIMIT):
        """Wait until an expression is true, and return its value."""
        end = time.monotonic() + seconds
        while not (found := self.value(expression)):
            assert time.monotonic() < end, (expression, self.value("document.body.innerText"))
            time.sleep(0.05)
        return found

    def screenshot(self, path, *, whole=True):
        """Write a picture of the page, or of what the screen shows."""
        found = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        path.write_bytes(base64.b64decode(found["data"]))


@contextmanager
def chromium(folder):
    """Start a browser; yield its only tab. Skips the test where there is none."""
    if (program := shutil.which("chromium")) is None:
        pytest.skip("no chromium: apt-get install chromium")
    profile = folder / "profile"
    with subprocess.Popen(
        [program, *OPTIONS, f"--user-data-dir={profile}", "about:blank"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        try:
            port = _port(profile / "DevToolsActivePort", process)
            with connect(
                _address(port), max_size=1 << 26, proxy=None, ping_interval=None
            ) as socket:
                yield Tab(socket)
        finally:
            process.terminate()
            process.wait(LIMIT)


def _port(file, process):
    end = time.monotonic() + LIMIT
    while not (file.exists() and (lines := file.read_text().splitlines())):
        assert process.poll() is None
        assert time.monotonic() < end
        time.sleep(0.05)
    return int(lines[0])


def _address(port):
    from urllib.request import ProxyHandler, build_opener

    with build_opener(ProxyHandler({})).open(
        f"http://127.0.0.1:{port}/json/list", timeout=LIMIT
    ) as answer:
        pages = [one for one in json.load(answer) if one["type"] == "page"]
    return pages[0]["webSocketDebuggerUrl"]
