"""A headless browser driven over its DevTools protocol, for tests that must see what a person sees."""

import base64
import io
import json
import shutil
import socket
import subprocess
import time
import urllib.request
from pathlib import Path

import numpy as np
from PIL import Image
from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1, 0, 0, 0],
    "position": [0, 0, 1.0],
    "fov": 0.7,
    "near": 0.1,
    "far": 60.0,
    "image_height": 300,
    "image_width": 400,
    "look_at": [0, 0, 0],
    "up_direction": [0, 0, 1],
}
"""Message with which a viewer tells where it looks from."""
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--hide-scrollbars",
    "--mute-audio",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-default-browser-check",
    "--remote-debugging-port=0",
)


def unused_port():
    """Return a port that nobody listens to: fixed ones collide when two test processes run."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


def find_browser():
    """Return the path of a browser, or None."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page of a headless browser. `requests` collects the address of everything that the page asks for."""

    def __init__(self, path, folder: Path, size=(1000, 620)):
        self.requests: list[str] = []
        self._id = 0
        command = [
            path,
            *FLAGS,
            f"--user-data-dir={folder}",
            f"--window-size={size[0]},{size[1]}",
            "about:blank",
        ]
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        address = self._page_address(folder / "DevToolsActivePort")
        self._socket = connect(address, max_size=None)
        for domain in ("Page", "Network", "Runtime"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=1,
            mobile=False,
        )

    def _page_address(self, file: Path, limit_s=30.0):
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            if file.is_file() and (lines := file.read_text().split()):
                with urllib.request.urlopen(
                    f"http://127.0.0.1:{lines[0]}/json",
                    timeout=5,
                ) as answer:
                    pages = [page for page in json.load(answer) if page["type"] == "page"]
                if pages:
                    return pages[0]["webSocketDebuggerUrl"]
            time.sleep(0.1)
        raise TimeoutError("the browser did not start")

    def call(self, method, limit_s=60.0, **params):
        """Send one command and return its result; events on the way are noted."""
        self._id += 1
        self._socket.send(json.dumps({"id": self._id, "method": method, "params": params}))
        end = time.monotonic() + limit_s
        while True:
            message = json.loads(self._socket.recv(timeout=max(0.0, end - time.monotonic())))
            self._note(message)
            if message.get("id") == self._id:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]

    def _note(self, message):
        if message.get("method") == "Network.requestWillBeSent":
            self.requests.append(message["params"]["request"]["url"])
        elif message.get("method") == "Network.webSocketCreated":
            self.requests.append(message["params"]["url"])

    def go(self, url, limit_s=30.0):
        """Open an address and wait until the page is loaded."""
        answer = self.call("Page.navigate", url=url)
        end = time.monotonic() + limit_s
        while time.monotonic() < end and self.evaluate("document.readyState") != "complete":
            time.sleep(0.2)
        return answer

    def text(self):
        """Return the words that the page shows."""
        return str(self.evaluate("document.body.innerText"))

    def evaluate(self, expression):
        """Return the value of an expression in the page."""
        try:
            answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        except RuntimeError:  # the page before has gone, the next one is not there yet
            return ""
        return answer.get("result", {}).get("value", "")

    def picture(self, save: Path | None = None):
        """Return (H, W, 3) uint8 of what the page shows."""
        data = base64.b64decode(self._screenshot())
        if save is not None:
            save.write_bytes(data)
        return np.array(Image.open(io.BytesIO(data)).convert("RGB"))

    def _screenshot(self, tries=3):
        for _ in range(tries - 1):
            try:
                return self.call("Page.captureScreenshot", limit_s=60.0, format="png")["data"]
            except (
                RuntimeError,
                TimeoutError,
            ):  # between two pages there is nothing to see, or no frame comes
                time.sleep(0.5)
        return self.call("Page.captureScreenshot", limit_s=60.0, format="png")["data"]

    def wait(self, ready, limit_s=40.0, pause_s=0.3):
        """Return the first picture for which `ready(picture)` holds, or the last one when time is up."""
        end = time.monotonic() + limit_s
        while True:
            picture = self.picture()
            if ready(picture) or time.monotonic() > end:
                return picture
            time.sleep(pause_s)

    def until(self, holds, limit_s=30.0):
        """Return whether `holds()` becomes true in time."""
        end = time.monotonic() + limit_s
        while not holds() and time.monotonic() < end:
            time.sleep(0.2)
        return holds()

    def close(self):
        """End the browser."""
        self._socket.close()
        self._process.terminate()
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(10)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
