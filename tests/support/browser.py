"""Headless Chromium over its debugging pipe: pages are opened, clicked, looked at, and what goes wrong is told."""

from __future__ import annotations

import base64
import fcntl
import io
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
OPTIONS = (
    *(
        "--headless=new",
        "--no-sandbox",
        "--remote-debugging-pipe",
        "--enable-unsafe-swiftshader",
        "--use-angle=swiftshader",
    ),
    *("--hide-scrollbars", "--no-first-run", "--disable-extensions", "--disable-background-networking"),
)


class Page:
    """A page of a running browser: ``faults`` of its console, and the addresses of its ``requests``."""

    def __init__(self, write: int, read: int) -> None:
        self._write, self._read, self._held, self._number, self._session = write, read, b"", 0, ""
        self.faults: list[str] = []
        self.requests: list[str] = []

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command of the DevTools protocol."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return dict(answer["result"])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._held:
            got = os.read(self._read, 1 << 20)
            if not got:
                raise RuntimeError("the browser has ended")
            self._held += got
        text, _, self._held = self._held.partition(b"\0")
        told: dict[str, Any] = json.loads(text)
        about = told.get("params", {})
        if told.get("method") == "Runtime.exceptionThrown":
            details = about["exceptionDetails"]
            self.faults.append(details.get("exception", {}).get("description", details["text"]))
        elif told.get("method") == "Runtime.consoleAPICalled" and about["type"] in ("error", "warning"):
            self.faults.append(" ".join(str(argument.get("value")) for argument in about["args"]))
        elif told.get("method") == "Log.entryAdded" and about["entry"]["level"] == "error":
            self.faults.append(about["entry"]["text"])
        elif told.get("method") == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])
        return told

    def attach(self) -> None:
        """Begin with an empty page."""
        target = self.send("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.send("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.send(f"{domain}.enable")

    def leave(self) -> None:
        """End the browser."""
        self._session = ""
        self.send("Browser.close")

    def open(
        self,
        path: Path,
        width: int = 1200,
        height: int = 800,
        *,
        dark: bool = False,
        still: bool = True,
        before: str = "",
    ) -> None:
        """Show a file; ``still`` is what people ask for who want no motion, ``before`` a script that runs first."""
        self.send(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500
        )
        features = {
            "prefers-color-scheme": "dark" if dark else "light",
            "prefers-reduced-motion": "reduce" if still else "",
        }
        self.send("Emulation.setEmulatedMedia", features=[{"name": n, "value": v} for n, v in features.items()])
        script = self.send("Page.addScriptToEvaluateOnNewDocument", source=before)["identifier"]
        self.send("Page.navigate", url=path.resolve().as_uri())
        self.wait("document.readyState === 'complete'")
        self.send("Page.removeScriptToEvaluateOnNewDocument", identifier=script)

    def run(self, script: str) -> Any:
        """The value of an expression, waited for where it is a promise."""
        done = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in done:
            raise RuntimeError(done["exceptionDetails"].get("exception", {}).get("description", "a script failed"))
        return done["result"].get("value")

    def wait(self, condition: str, seconds: float = 60.0) -> None:
        """Until an expression is true."""
        end = time.monotonic() + seconds
        while not self.run(f"Boolean({condition})"):
            if time.monotonic() > end:
                raise RuntimeError(f"not within {seconds} s: {condition}; faults: {self.faults}")
            time.sleep(0.05)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """One event: mousePressed, mouseMoved or mouseReleased."""
        self.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press at a place, move, and let go at another."""
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start, button="left", clickCount=1)
        if start != end:
            for part in (0.3, 0.7, 1.0):
                at = [a + part * (b - a) for a, b in zip(start, end, strict=True)]
                self.mouse("mouseMoved", *at, button="left", buttons=1)
        self.mouse("mouseReleased", *end, button="left", clickCount=1)

    def key(self, key: str) -> None:
        """Press a key and let it go."""
        for kind in ("keyDown", "keyUp"):
            self.send(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                **({"text": key} if len(key) == 1 and kind == "keyDown" else {}),
            )

    def picture(self, path: Path | None = None) -> NDArray[np.int64]:
        """What is seen, (height, width, 3); written to a file too where one is named."""
        data = base64.b64decode(self.send("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(data)
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=np.int64)


@contextmanager
def browser(folder: Path) -> Iterator[Page]:
    """A browser with a profile in ``folder``, which ends with the block."""
    (to_read, write), (read, to_write) = os.pipe(), os.pipe()

    def take_pipes() -> None:
        # The protocol wants to read from 3 and to write to 4. Copies beyond these come first: either may be taken, and
        # one that was free would be copied onto itself, which does not stay open in the browser.
        kept = [fcntl.fcntl(end, fcntl.F_DUPFD, 5) for end in (to_read, to_write)]
        os.dup2(kept[0], 3)
        os.dup2(kept[1], 4)

    command = [str(CHROMIUM), *OPTIONS, f"--user-data-dir={folder / 'profile'}"]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        close_fds=False,
        preexec_fn=take_pipes,
    )
    os.close(to_read)
    os.close(to_write)
    page = Page(write, read)
    try:
        page.attach()
        yield page
    finally:
        with suppress(OSError, RuntimeError):
            page.leave()
        os.close(write)
        os.close(read)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
