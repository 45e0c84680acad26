"""Chromium over the pipe of its DevTools protocol: opens a page and says what it loaded, logged and shows."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--remote-debugging-pipe",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    "--hide-scrollbars",
)


class Page:
    """A tab of the browser.

    Attributes:
        problems: what its console and its exceptions say.
        requests: addresses that it asked for, those of data left out.
    """

    def __init__(self, to: Any, back: Any) -> None:
        self._to, self._back, self._number, self._session = to, back, 0, None
        self.problems: list[str] = []
        self.requests: list[str] = []
        self._events: list[str] = []
        target = self("Target.createTarget", url="about:blank")["targetId"]
        self._session = self("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self(f"{domain}.enable")

    def __call__(self, method: str, **options: Any) -> dict[str, Any]:
        """Return the answer to a command."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": options}
        message |= {"sessionId": self._session} if self._session else {}
        self._to.write(json.dumps(message).encode() + b"\0")
        self._to.flush()
        while (answer := self._read()).get("id") != self._number:
            pass
        assert "error" not in answer, answer
        return answer["result"]

    def open(self, path: Path, width: int, height: int = 900, *, dark: bool = False) -> None:
        """Open a file from the disk in a window of a size, and wait until it is loaded."""
        self(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self("Emulation.setEmulatedMedia", features=[scheme])
        self._events.clear()
        self("Page.navigate", url=path.resolve().as_uri())
        while "Page.loadEventFired" not in self._events:
            self._read()
        self.value("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, awaited."""
        answer = self("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def picture(self, *, whole: bool = False) -> bytes:
        """Return a screenshot of the window or of the whole page, the content of a PNG file."""
        return base64.b64decode(self("Page.captureScreenshot", captureBeyondViewport=whole)["data"])

    def _read(self) -> dict[str, Any]:
        """Return the next message, and note what it says of the page."""
        message = json.loads(self._back.readline()[:-1])
        method, said = message.get("method", ""), message.get("params", {})
        self._events.append(method)
        if method == "Runtime.exceptionThrown":
            self.problems.append(str(said["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled" and said["type"] in ("error", "assert"):
            self.problems.append(str(said["args"]))
        elif method == "Log.entryAdded" and said["entry"]["level"] == "error":
            self.problems.append(str(said["entry"]))
        elif method == "Network.requestWillBeSent":
            address = said["request"]["url"]
            self.requests += [] if address.startswith(("data:", "blob:")) else [address]
        return message


class _Lines:
    """Messages of a pipe, which end with a zero byte."""

    def __init__(self, file: Any) -> None:
        self._file, self._rest = file, b""

    def readline(self) -> bytes:
        while b"\0" not in self._rest:
            more = os.read(self._file.fileno(), 1 << 20)
            if not more:
                raise EOFError("the browser has ended")
            self._rest += more
        line, _, self._rest = self._rest.partition(b"\0")
        return line + b"\0"


@contextmanager
def browser(folder: Path) -> Iterator[Page]:
    """Give a page of a browser that keeps its profile in a folder, and end the browser."""
    assert CHROMIUM is not None
    hear, tell = os.pipe()
    listen, speak = os.pipe()

    def connect() -> None:  # the browser reads from descriptor 3 and writes to 4
        first, second = os.dup(hear), os.dup(speak)
        os.dup2(first, 3)
        os.dup2(second, 4)

    command = [CHROMIUM, *FLAGS, f"--user-data-dir={folder}"]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    process = subprocess.Popen(command, preexec_fn=connect, close_fds=False, **quiet)
    os.close(hear)
    os.close(speak)
    with os.fdopen(tell, "wb") as to, os.fdopen(listen, "rb") as back:
        try:
            yield Page(to, _Lines(back))
        finally:
            process.terminate()
            process.wait()
