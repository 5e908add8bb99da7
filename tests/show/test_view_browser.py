"""`minidual view` seen by a real browser without a screen: the picture must show the scene, and nothing else passes.

Needs Chromium (Debian package `chromium`); skipped, with that reason, where there is none.
"""

import functools
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import viser

from minidual.config.root import ViewConfig
from minidual.show.view import make_view
from minidual.show.view.web import WebView
from tests.support.browser import Browser, find_browser, unused_port

BROWSER = find_browser()
pytestmark = pytest.mark.skipif(
    BROWSER is None,
    reason="no browser: none of chromium, chromium-browser, google-chrome is in PATH",
)
Picture = npt.NDArray[np.uint8]


class QuietHandler(SimpleHTTPRequestHandler):
    """Serves a folder without a log."""

    def log_message(self, *_: object) -> None:
        """Print nothing."""


def shows_scene(picture: Picture) -> bool:
    """Return whether a picture has the rod's orange, the goal's green, a grey-blue table and white arms."""
    p = picture[60:, :370].astype(int)  # below the browser's notice, beside the panel
    r = p[..., 0]
    g = p[..., 1]
    b = p[..., 2]
    orange = ((r > 190) & (g > 70) & (g < 190) & (b < 110) & (r - b > 100)).mean()
    green = ((g - r > 50) & (g - b > 30)).mean()
    table = ((b - r > 8) & (b - r < 50) & (g > 90) & (g < 190)).mean()
    colours = len(np.unique(p.reshape(-1, 3), axis=0))
    return 0.001 < orange < 0.05 and 0.001 < green < 0.05 and table > 0.1 and colours > 1500


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with Browser(
        BROWSER,
        tmp_path_factory.mktemp("browser"),
        size=(720, 420),
    ) as made:  # drawn in software
        yield made


@pytest.fixture(scope="module")
def process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    """Run `minidual view`; it loads while the first test runs."""
    folder = tmp_path_factory.mktemp("runs")
    command = [
        sys.executable,
        "-m",
        "minidual.cli",
        "view",
        "--view",
        "web",
        "--for-s",
        "400",
        "--json",
        "--view-port",
        str(unused_port()),
        "--set",
        "view.rate_hz=4",
        "--runs-dir",
        str(folder),
    ]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGINT,
            signal.SIG_DFL,
        ),  # ignored under a background job
    )
    yield process
    if process.poll() is None:
        process.kill()
    process.communicate()


@pytest.fixture(scope="module")
def address(process: subprocess.Popen[str]) -> str:
    """Return the address that `minidual view` printed."""
    assert process.stderr is not None
    found = next(
        (found for line in process.stderr if (found := re.match(r"view: (\S+)", line))),
        None,
    )
    assert found, "the command printed no address"
    return found[1]


@pytest.mark.usefixtures("process")
def test_pages_without_the_scene_do_not_pass(browser: Browser) -> None:
    """Negative controls: a blank page, a page that nobody serves, and the server without a scene."""
    assert not shows_scene(browser.picture())
    assert browser.go("http://127.0.0.1:9/").get("errorText")
    assert not shows_scene(browser.picture())
    empty = make_view("web", ViewConfig(port=unused_port()), say=lambda _line: None)
    assert empty is not None
    try:
        browser.go(str(empty.url))
        browser.wait(lambda picture: bool(np.ptp(picture) > 50), limit_s=20.0)
        time.sleep(0.5)
        assert "minidual" in browser.text()  # the page is there; what it should show is not
        assert not shows_scene(browser.picture())
    finally:
        empty.close()


def test_a_page_of_another_program_on_this_machine_is_refused_though_it_has_the_cookie(
    browser: Browser,
    tmp_path: Path,
) -> None:
    """Cookies know no ports: the browser sends the view's cookie along, and Origin tells the pages apart."""
    said: list[str] = []
    view = make_view("web", ViewConfig(port=unused_port()), say=said.append)
    assert isinstance(view, WebView)
    script = f"""<h1 id=h>waiting</h1><script>const s = new WebSocket("ws://127.0.0.1:{view.port}", ["viser-v{viser.__version__}"]);
        s.onopen = () => h.innerText = "open"; s.onclose = () => h.innerText = "refused"</script>"""
    (tmp_path / "index.html").write_text(script)
    handler = functools.partial(QuietHandler, directory=str(tmp_path))
    stranger = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=stranger.serve_forever, daemon=True).start()
    try:
        browser.go(str(view.url))
        assert browser.until(lambda: bool(view._server.get_clients()))  # its own page is let in
        assert said == []
        browser.go(f"http://127.0.0.1:{stranger.server_port}/")
        assert browser.until(lambda: browser.text() in ("refused", "open"))
        assert browser.text() == "refused"
        assert f"it comes from a page of http://127.0.0.1:{stranger.server_port}" in said[0]
    finally:
        browser.go("about:blank")
        stranger.shutdown()
        stranger.server_close()
        view.close()


@pytest.mark.timeout(400)  # drawn in software, on a busy machine, a picture can take half a minute
def test_the_scene_is_in_the_picture_and_nothing_comes_from_the_net(
    browser: Browser,
    address: str,
) -> None:
    browser.requests.clear()
    browser.go(address)
    picture = browser.wait(shows_scene, limit_s=180.0)
    assert shows_scene(picture)
    words = browser.text()
    for text in (
        "source in control",
        "sliders",
        "x real time",
        "pinch, left hand",
        "right arm",
    ):
        assert text in words
    seconds = re.compile(r"simulated time\s+([\d.]+) s")
    first = seconds.search(browser.text())
    assert first

    def time_goes_on() -> bool:
        shown = seconds.search(browser.text())
        return shown is not None and float(shown[1]) > float(first[1])

    assert browser.until(time_goes_on, limit_s=60.0)
    foreign = [
        asked[:100]
        for asked in browser.requests
        if not re.match(
            r"(https?|ws)://127\.0\.0\.1:\d+/|data:|blob:http://127\.0\.0\.1:|chrome:|about:",
            asked,
        )
    ]
    assert browser.requests
    assert foreign == []


@pytest.mark.timeout(400)  # as above
def test_a_closed_page_stops_nothing_and_ctrl_c_is_a_clean_end(
    browser: Browser,
    process: subprocess.Popen[str],
    address: str,
) -> None:
    browser.go(
        address,
    )  # another worker than that of the test above has a command of its own, which still loads
    assert shows_scene(browser.wait(shows_scene, limit_s=60.0))
    browser.go("about:blank")
    time.sleep(0.5)
    assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert process.returncode == 0
    assert '"simulated_s"' in out
    assert "Traceback" not in err


def test_the_browser_keeps_no_profile_in_the_checkout() -> None:
    root = Path(__file__).resolve().parents[2]
    assert not list(root.glob("**/DevToolsActivePort"))
