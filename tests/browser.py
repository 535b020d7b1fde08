"""A headless Chromium over the DevTools protocol: no driver and no library, two pipes."""

from __future__ import annotations

import base64
import io
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless=new",
    "--remote-debugging-pipe",
    "--no-sandbox",
    "--no-first-run",
    "--disable-gpu-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--disable-background-networking",
)
PATIENCE = 60.0
"""Seconds that software rendering may take for anything."""


def find_browser() -> str | None:
    """Where Chromium is, or None; the variable GCND_BROWSER names one."""
    return os.environ.get("GCND_BROWSER") or next(filter(None, map(shutil.which, NAMES)), None)


class Browser:
    """One page in a running browser."""

    def __init__(self, process: subprocess.Popen[bytes], into: int, out_of: int) -> None:
        self._process, self._into, self._out_of = process, into, out_of
        self._buffer, self._last_id, self._session = b"", 0, None
        self.events: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Sends a command and returns its result; what happens meanwhile goes to `events`."""
        self._last_id += 1
        message: dict[str, Any] = {"id": self._last_id, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._into, json.dumps(message).encode() + b"\0")
        deadline = time.monotonic() + PATIENCE
        while True:
            answer = self._read(deadline)
            if answer.get("id") == self._last_id:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return dict(answer["result"])
            self.events.append(answer)

    def _read(self, deadline: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            if not select.select([self._out_of], [], [], max(0.0, deadline - time.monotonic()))[0]:
                raise TimeoutError(f"no answer from the browser in {PATIENCE} s")
            data = os.read(self._out_of, 1 << 20)
            if not data:
                raise RuntimeError("the browser ended")
            self._buffer += data
        message, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(message))

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression; a promise is awaited."""
        result = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True, userGesture=True
        )
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"]["exception"].get("description", result))
        return result["result"].get("value")

    def open(self, page: Path, width: int = 1280, height: int = 800) -> None:
        """Opens a page of this size and waits for its first picture, or for it to say that there is none."""
        self.events.clear()
        self.resize(width, height)
        self.call("Page.navigate", url=page.resolve().as_uri())
        deadline = time.monotonic() + PATIENCE
        while self.evaluate("document.documentElement?.dataset.state") not in ("ready", "failed"):
            if time.monotonic() > deadline:
                raise TimeoutError(f"nothing was drawn in {PATIENCE} s")
            time.sleep(0.05)
        self.settle()

    def read(self, page: Path, width: int, height: int = 800) -> None:
        """Opens a page of this size that draws nothing."""
        self.events.clear()
        self.resize(width, height)
        self.call("Page.navigate", url=page.resolve().as_uri())
        deadline = time.monotonic() + PATIENCE
        while (
            self.evaluate("[location.href, document.readyState].join()")
            != f"{page.resolve().as_uri()},complete"
        ):
            if time.monotonic() > deadline:
                raise TimeoutError(f"nothing was read in {PATIENCE} s")
            time.sleep(0.05)

    def resize(self, width: int, height: int) -> None:
        """Gives the window another size."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )

    def settle(self) -> None:
        """Waits until everything asked for is drawn: an answer, layout, drawing."""
        for _ in range(3):
            self.evaluate("new Promise(done => requestAnimationFrame(() => done(null)))")

    def set(self, element: str, value: str | bool, event: str = "change") -> None:
        """Gives a form element a value as a person would, and waits for the picture."""
        field = "checked" if isinstance(value, bool) else "value"
        self.evaluate(
            f"(() => {{ const e = document.querySelector({json.dumps(element)}); e.{field} = {json.dumps(value)};"
            f" e.dispatchEvent(new Event('{event}', {{bubbles: true}})); }})()"
        )
        self.settle()

    def click(self, element: str) -> None:
        """Clicks an element."""
        self.evaluate(f"document.querySelector({json.dumps(element)}).click()")
        self.settle()

    def press(self, key: str) -> None:
        """Presses a key on what has the focus."""
        text = {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, **(text if kind == "keyDown" else {}))
        self.settle()

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 5) -> None:
        """Drags the mouse with the left button."""
        mouse = "Input.dispatchMouseEvent"
        self.call(mouse, type="mousePressed", x=start[0], y=start[1], button="left", buttons=1, clickCount=1)
        for i in range(1, steps + 1):
            x, y = (a + (b - a) * i / steps for a, b in zip(start, end, strict=True))
            self.call(mouse, type="mouseMoved", x=x, y=y, button="left", buttons=1)
        self.call(mouse, type="mouseReleased", x=end[0], y=end[1], button="left", buttons=0, clickCount=1)
        self.settle()

    def picture(self, element: str | None = None) -> NDArray[np.int16]:
        """RGB (height, width, 3) of the window, or of an element in it."""
        options: dict[str, Any] = {}
        if element:
            box = self.evaluate(
                f"(() => {{ const r = document.querySelector({json.dumps(element)}).getBoundingClientRect();"
                " return {x: r.x, y: r.y, width: r.width, height: r.height}; })()"
            )
            options["clip"] = box | {"scale": 1}
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png", **options)["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(np.int16)

    def complaints(self) -> list[str]:
        """Errors and warnings of the page since it was opened, from its program and from the browser."""
        self.settle()
        said = []
        for event in self.events:
            params = event.get("params", {})
            if event.get("method") == "Runtime.exceptionThrown":
                said.append(str(params["exceptionDetails"]))
            elif event.get("method") == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning"):
                said.append(" ".join(str(part.get("value")) for part in params["args"]))
            elif event.get("method") == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
                said.append(params["entry"]["text"])
        return said

    def requests(self) -> list[str]:
        """Addresses that were asked for since the page was opened, without what the page carries in itself."""
        urls = [
            event["params"]["request"]["url"]
            for event in self.events
            if event.get("method") == "Network.requestWillBeSent"
        ]
        return [url for url in urls if not url.startswith("data:")]


@contextmanager
def running_browser(executable: str, profile: Path, *flags: str) -> Iterator[Browser]:
    """Starts a browser, and ends it."""
    (read_commands, into), (out_of, write_answers) = os.pipe(), os.pipe()

    def hand_over() -> None:
        # DevTools reads commands from file 3 and answers on file 4; the copies keep the two apart while they move.
        commands, answers = os.dup(read_commands), os.dup(write_answers)
        os.dup2(commands, 3)
        os.dup2(answers, 4)

    process = subprocess.Popen(
        [executable, *FLAGS, f"--user-data-dir={profile}", *flags, "about:blank"],
        preexec_fn=hand_over,
        close_fds=False,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(read_commands)
    os.close(write_answers)
    try:
        yield Browser(process, into, out_of)
    finally:
        os.close(into)
        os.close(out_of)
        process.terminate()
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
