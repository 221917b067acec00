"""A page in headless Chromium, over the DevTools protocol.

Chromium reads commands from its descriptor 3 and answers on 4 (--remote-debugging-pipe), so that
no driver and no port are needed.
"""

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

KEYS = {"Tab": 9, "Enter": 13, "Escape": 27}  # by name, with the code of Windows
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
FLAGS = (
    "--headless=new",
    "--no-sandbox",  # which a container without user namespaces cannot have
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--window-size=1400,1600",
    "--force-prefers-reduced-motion",
    "--remote-debugging-pipe",
)


def find_chromium() -> str | None:
    """The browser's path: $CHROMIUM, or the first of its usual names; None without one."""
    names = (os.environ.get("CHROMIUM") or NAMES[0], *NAMES)
    return next(filter(None, map(shutil.which, names)), None)


class Page:
    """One tab."""

    def __init__(self, commands: Any, answers: Any) -> None:
        self._commands, self._answers = commands, answers
        self._number = 0
        self._session: str | None = None
        self.errors: list[str] = []  # of the page, and requests of other sites
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        attached = self._call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._call(f"{domain}.enable")

    def open_anew(self, url: str) -> None:
        """Load a page as if for the first time, and wait until its scripts have run."""
        self._call("Page.navigate", url="about:blank")
        self.errors.clear()
        self._own = ("data:", "blob:", "about:", url.split("?")[0])
        self._call("Page.navigate", url=url)
        self.wait("document.readyState === 'complete'")

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression. Raises AssertionError where it fails."""
        answer = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def text(self, selector: str) -> str:
        """What an element says."""
        return self.evaluate(f"document.querySelector({selector!r}).innerText")

    def click(self, selector: str) -> None:
        self.evaluate(f"document.querySelector({selector!r}).click()")

    def drag(self, *places: tuple[float, float]) -> None:
        """Press the mouse at the first place and release it at the last one, CSS pixels."""
        mouse = "Input.dispatchMouseEvent"
        pressed = {"button": "left", "clickCount": 1}
        (x, y), *others = places
        self._call(mouse, type="mouseMoved", x=x, y=y)
        self._call(mouse, type="mousePressed", x=x, y=y, **pressed)
        for x, y in others:
            self._call(mouse, type="mouseMoved", x=x, y=y, button="left", buttons=1)
        self._call(mouse, type="mouseReleased", x=x, y=y, **pressed)

    def tap(self, x: float, y: float) -> None:
        """Touch a place with a finger."""
        touch = "Input.dispatchTouchEvent"
        self._call(touch, type="touchStart", touchPoints=[{"x": x, "y": y}])
        self._call(touch, type="touchEnd", touchPoints=[])

    def press(self, *keys: str) -> None:
        """Press keys of `KEYS`, one after the other."""
        for key in keys:
            text = {"text": "\r"} if key == "Enter" else {}
            named = {"key": key, "code": key, "windowsVirtualKeyCode": KEYS[key]}
            self._call("Input.dispatchKeyEvent", type="keyDown", **named, **text)
            self._call("Input.dispatchKeyEvent", type="keyUp", **named)

    def choose(self, selector: str, *files: Path) -> None:
        """Choose files in an input, as by its dialogue."""
        found = self._call("Runtime.evaluate", expression=f"document.querySelector({selector!r})")
        paths = [str(file) for file in files]
        self._call("DOM.setFileInputFiles", files=paths, objectId=found["result"]["objectId"])

    def wait(self, expression: str, seconds: float = 60) -> None:
        """Until a JavaScript expression is true. Raises AssertionError after so many seconds."""
        deadline = time.monotonic() + seconds
        while not self.evaluate(expression):
            assert time.monotonic() < deadline, f"still not: {expression}"
            time.sleep(0.05)

    def screenshot(self, path: Path, width: int, height: int | None = None) -> None:
        """Write the whole page, or its top, as a PNG of so many pixels."""
        size = {"width": width, "height": height or 800, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **size)
        time.sleep(1)  # drawing goes on after loading
        tall = height or self.evaluate("document.documentElement.scrollHeight")
        clip = {"x": 0, "y": 0, "width": width, "height": tall, "scale": 1}
        answer = self._call("Page.captureScreenshot", clip=clip, captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(answer["data"]))

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        self._commands.write(json.dumps(message).encode() + b"\0")
        self._commands.flush()
        while True:
            received = bytearray()
            while (byte := self._answers.read(1)) != b"\0":
                assert byte, "Chromium ended"
                received += byte
            answer = json.loads(received)
            if answer.get("id") == self._number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]
            self._note(answer.get("method"), answer.get("params"))

    def _note(self, method: str, parameters: dict[str, Any]) -> None:
        if method == "Runtime.exceptionThrown":
            self.errors.append(json.dumps(parameters["exceptionDetails"]))
        elif method == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.errors.append(parameters["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            url = parameters["request"]["url"]
            if not url.startswith(self._own):
                self.errors.append(f"a request for {url}")


@contextmanager
def chromium_page(executable: str) -> Iterator[Page]:
    """Start the browser with a profile of its own, and end it afterwards."""
    command_out, command_in = os.pipe()
    answer_out, answer_in = os.pipe()

    def as_3_and_4() -> None:
        # Through high numbers first: the pipes may be 3 and 4 themselves.
        os.dup2(os.dup2(command_out, 100), 3)
        os.dup2(os.dup2(answer_in, 101), 4)

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        process = subprocess.Popen(
            [executable, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            preexec_fn=as_3_and_4,
            close_fds=False,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(command_out)
        os.close(answer_in)
        try:
            with os.fdopen(command_in, "wb") as commands, os.fdopen(answer_out, "rb") as answers:
                yield Page(commands, answers)
        finally:
            process.kill()
            process.wait()
