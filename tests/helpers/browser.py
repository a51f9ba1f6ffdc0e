"""Chromium without a window, driven over the DevTools protocol, through a pipe.

    with Browser() as browser:
        page = browser.open(path, width=390, dark=True)
        page.wait_for("document.querySelector('.ready')")
        assert not page.errors

``needs_browser`` skips a test where there is none.
"""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
FOUND = next(filter(None, map(shutil.which, NAMES)), None)
FLAGS = ("--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
         "--enable-unsafe-swiftshader", "--hide-scrollbars", "--no-first-run",
         "--disable-background-networking", "--remote-debugging-pipe", "--disable-dev-shm-usage")
WAIT = 60.0
"""Longest wait for anything, s."""

needs_browser = pytest.mark.skipif(
    FOUND is None, reason="no headless Chromium here: install chromium to see the pages drawn")


class Browser:
    """One browser, ended with the ``with`` block. Its pages are independent."""

    def __enter__(self) -> Browser:
        assert FOUND is not None
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        read, self._out = os.pipe()
        self._in, write = os.pipe()
        # Chromium reads its descriptor 3 and answers on 4
        self._process = subprocess.Popen(
            ["sh", "-c", f'exec "$@" 3</dev/fd/{read} 4>/dev/fd/{write}', "sh", FOUND, *FLAGS,
             f"--user-data-dir={self._profile.name}", "about:blank"], pass_fds=(read, write),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(read)
        os.close(write)
        self._rest, self._last = b"", 0
        self._pages: dict[str, Page] = {}
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.ask("Browser.close", patience=5.0)
            self._process.wait(5.0)
        except (OSError, TimeoutError, RuntimeError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        os.close(self._in)
        os.close(self._out)
        self._profile.cleanup()

    def open(self, page: Path | str, width: int = 1280, height: int = 900, dark: bool = False,
             touch: bool = False) -> Page:
        """Open a file, or an address, in a page of its own; wait until it is loaded."""
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        one = self._pages[session] = Page(self, session, target)
        for domain in ("Page", "Runtime", "Log", "Network"):
            one.ask(f"{domain}.enable")
        one.resize(width, height, touch)
        one.media(dark)
        one.loaded = False
        one.ask("Page.navigate", url=page.resolve().as_uri() if isinstance(page, Path) else page)
        self._until(lambda: one.loaded, f"{page} does not load")
        return one

    def ask(self, method: str, session: str = "", patience: float = WAIT, **values: Any) -> Any:
        """Send one command and return its answer; events that come before it are kept."""
        self._last += 1
        own = self._last
        message = {"id": own, "method": method, "params": values}
        if session:
            message["sessionId"] = session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        found: list[Any] = []
        self._until(lambda: bool(found), f"no answer to {method}", patience, own, found)
        if "error" in found[0]:
            raise RuntimeError(f"{method}: {found[0]['error']['message']}")
        return found[0].get("result", {})

    def pump(self, seconds: float) -> None:
        """Take events for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._take(left)

    def _until(self, done: Any, what: str, patience: float = WAIT, own: int = 0,
               found: list[Any] | None = None) -> None:
        end = time.monotonic() + patience
        while not done():
            left = end - time.monotonic()
            if left <= 0.0:
                raise TimeoutError(what)
            for message in self._take(left):
                if message.get("id") == own and found is not None:
                    found.append(message)

    def _take(self, patience: float) -> list[dict[str, Any]]:
        """Return answers that came; events go to their page."""
        if not select.select([self._in], [], [], min(patience, 1.0))[0]:
            return []
        got = os.read(self._in, 1 << 20)
        if not got:
            raise RuntimeError("the browser has ended")
        *whole, self._rest = (self._rest + got).split(b"\0")
        answers = []
        for text in whole:
            message = json.loads(text)
            if "id" in message:
                answers.append(message)
            elif (one := self._pages.get(message.get("sessionId", ""))) is not None:
                one.event(message["method"], message["params"])
        return answers


class Page:
    """One page.

    Attributes:
        errors: what the console holds of errors and warnings, and what was thrown.
        requests: addresses that were asked for, without the page itself and ``data:``.
    """

    def __init__(self, browser: Browser, session: str, target: str) -> None:
        self._browser, self._session, self._target = browser, session, target
        self.loaded = False
        self.errors: list[str] = []
        self.requests: list[str] = []

    def ask(self, method: str, **values: Any) -> Any:
        """Send one command of the protocol."""
        return self._browser.ask(method, self._session, **values)

    def event(self, method: str, values: dict[str, Any]) -> None:
        """Keep what an event says."""
        if method == "Page.loadEventFired":
            self.loaded = True
        elif method == "Runtime.exceptionThrown":
            details = values["exceptionDetails"]
            self.errors.append(str(details.get("exception", {}).get("description",
                                                                    details["text"])))
        elif method == "Runtime.consoleAPICalled" and values["type"] in ("error", "assert",
                                                                         "warning"):
            self.errors.append(" ".join(str(a.get("value", a.get("description")))
                                        for a in values["args"]))
        elif method == "Log.entryAdded" and values["entry"]["level"] == "error":
            self.errors.append(values["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            url = values["request"]["url"]
            if not url.startswith(("data:", "blob:")) and values.get("type") != "Document":
                self.requests.append(url)

    def evaluate(self, script: str) -> Any:
        """Return the value of an expression, of a promise what it comes to."""
        done = self.ask("Runtime.evaluate", expression=script, awaitPromise=True,
                        returnByValue=True)
        if "exceptionDetails" in done:
            details = done["exceptionDetails"]
            raise RuntimeError(details.get("exception", {}).get("description", details["text"]))
        return done["result"].get("value")

    def wait_for(self, script: str, patience: float = WAIT) -> Any:
        """Wait until an expression is true, and return it."""
        end = time.monotonic() + patience
        while not (value := self.evaluate(
                f"(async () => {{ const v = await ({script});"
                " return v instanceof Node ? true : v })()")):
            if time.monotonic() > end:
                raise TimeoutError(f"{script} stays {value}; {self.errors}")
            self.pause(0.05)
        return value

    def pause(self, seconds: float) -> None:
        """Let the page go on for a while."""
        self._browser.pump(seconds)

    def resize(self, width: int, height: int, touch: bool = False) -> None:
        """Set the size of the window in CSS pixels."""
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height,
                 deviceScaleFactor=1, mobile=False)
        self.ask("Emulation.setTouchEmulationEnabled", enabled=touch)

    def media(self, dark: bool = False, kind: str = "") -> None:
        """Prefer a dark or a light page, on a screen or with ``kind`` "print"."""
        self.ask("Emulation.setEmulatedMedia", media=kind, features=[
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])

    def middle(self, selector: str) -> tuple[float, float]:
        """Scroll the first element to the middle of the window; return where its middle is."""
        x, y = self.evaluate(
            f"(() => {{ const e = document.querySelector({json.dumps(selector)});"
            "e.scrollIntoView({block: 'center', behavior: 'instant'});"
            "const b = e.getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2] })()")
        return x, y

    def hover(self, x: float, y: float) -> None:
        """Move the mouse to a place of the window."""
        for step in (-3.0, -1.0, 0.0):
            self.ask("Input.dispatchMouseEvent", type="mouseMoved", x=x + step, y=y)
            self.pause(0.08)  # pages may take no more than so many moves a second

    def click(self, x: float, y: float) -> None:
        """Click at a place of the window."""
        self.hover(x, y)
        for what in ("mousePressed", "mouseReleased"):
            self.ask("Input.dispatchMouseEvent", type=what, x=x, y=y, button="left", clickCount=1)

    def drag(self, x: float, y: float, to_x: float, to_y: float) -> None:
        """Press at one place, move to another, release."""
        self.hover(x, y)
        self.ask("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, button="left",
                 clickCount=1)
        for part in (0.3, 0.7, 1.0):
            self.ask("Input.dispatchMouseEvent", type="mouseMoved", x=x + part * (to_x - x),
                     y=y + part * (to_y - y), button="left")
        self.ask("Input.dispatchMouseEvent", type="mouseReleased", x=to_x, y=to_y, button="left",
                 clickCount=1)

    def key(self, name: str) -> None:
        """Press a key, such as Escape, Tab or ArrowRight."""
        for what in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", type=what, key=name, code=name)

    def screenshot(self, path: Path | str, whole: bool = False) -> None:
        """Write a PNG of the window, or of the ``whole`` page."""
        done = self.ask("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        Path(path).write_bytes(base64.b64decode(done["data"]))

    def pdf(self, path: Path | str) -> None:
        """Print the page into a file."""
        Path(path).write_bytes(base64.b64decode(
            self.ask("Page.printToPDF", printBackground=True)["data"]))

    def close(self) -> None:
        """Close the page."""
        self._browser.ask("Target.closeTarget", targetId=self._target)
