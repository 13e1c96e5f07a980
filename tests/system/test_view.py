"""The live page in a real browser, on a running daemon with a real host, and on its recording."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from emulator.hosts.lines import LineClosed, SerialLine
from emulator.hosts.lms2xx import Lms2xxHost
from emulator.runtime.control import ask
from tests.system.conftest import TIME_LIMIT_S
from tests.system.nursery import begun

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")
ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "reports"
PATIENCE_S = 4 * TIME_LIMIT_S
"A browser that draws without a graphics card stands for a minute where others want the processor too."
TOKEN = "correcthorsebattery"
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1000,640",
    "--force-device-scale-factor=0.5",
)
FEWER_PICTURES = """
const draw = window.requestAnimationFrame
window.requestAnimationFrame = (picture) => setTimeout(() => draw(picture), 500)
"""
"Without a graphics card pictures cost a whole core: two small ones a second will do."
POINTS = "return Math.max(0, ...[...document.querySelectorAll('.view-sensor')].map(one => +one.dataset.points))"
NOW = "const one = document.getElementById('view-time'); return one ? +one.dataset.now : -1"

if os.environ.get("CI") != "true":
    pytest.importorskip("viser", reason="extra `view` is not installed")
    pytest.importorskip("selenium", reason="selenium is not installed")
    if CHROMIUM is None or DRIVER is None:
        pytest.skip("no chromium and chromedriver on this machine", allow_module_level=True)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    assert CHROMIUM is not None, "CI has to have chromium"
    assert DRIVER is not None, "CI has to have chromedriver"
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('browser')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    found = webdriver.Chrome(options=options, service=Service(DRIVER, popen_kw={"preexec_fn": lambda: os.nice(5)}))
    found.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": FEWER_PICTURES})
    found.set_script_timeout(PATIENCE_S)  # a page that draws on a busy machine answers late
    yield found
    found.quit()


@pytest.fixture
def view(tmp_path: Path) -> Iterator[Callable[..., str]]:
    """Starts `lidaremu view`; the address of its page."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> str:
        words = ("view", *arguments, "--no-browser", "--json", "--token", TOKEN)
        process = begun(*words, cwd=tmp_path, stderr=None)
        started.append(process)
        assert process.stdout is not None
        return str(json.loads(process.stdout.readline())["url"])

    yield start
    for process in started:
        process.terminate()
        out, _ = process.communicate(timeout=PATIENCE_S)
        assert (process.returncode, out) == (0, "")


class Reading(threading.Thread):
    """A host that reads all the time and keeps its last scan."""

    def __init__(self, path: str) -> None:
        super().__init__(daemon=True)
        self.host = Lms2xxHost(SerialLine(path, 9600), 38_400)  # five scans a second, not 37: they cost a core's third
        self.last = np.zeros(0)
        self.count = 0
        self.over = False
        self.start()

    def run(self) -> None:
        with contextlib.suppress(LineClosed):  # the run has ended first, as where the test has failed
            for scan in self.host.scans(0.2):
                if self.over:
                    return
                if scan is not None:
                    self.last, self.count = scan.range_m, self.count + 1

    @property
    def wall(self) -> int:
        """Beams that measure the wall 30 m ahead."""
        return int(np.count_nonzero(self.last > 28.0))

    def end(self) -> None:
        self.over = True
        self.join(2.0)


def answered(url: str, **headers: str) -> int:
    """The status with which a request is answered."""
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=TIME_LIMIT_S) as answer:
            return int(answer.status)
    except urllib.error.HTTPError as refused:
        refused.close()
        return refused.code


def until(what: Callable[[], object], seconds: float = PATIENCE_S, why: str = "") -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, why
        time.sleep(0.05)


def there(browser: Any, xpath: str) -> Any:
    """That element, as soon as the page has drawn it: a busy machine draws it late."""
    until(lambda: browser.find_elements("xpath", xpath), why=f"nothing like {xpath}")
    return browser.find_element("xpath", xpath)


def press(browser: Any, text: str) -> None:
    """The button of that name; scrolled to, as nobody can press what is out of sight."""
    button = there(browser, f"//button[normalize-space(.)='{text}']")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
    button.click()


def stand(browser: Any) -> None:
    """A recording that stands: because it is over by the time the page has been drawn, or because it is told to."""
    moving = there(browser, "//button[normalize-space(.)='Pause' or normalize-space(.)='Resume']")
    if moving.text.strip() == "Pause":
        browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", moving)
        moving.click()
    there(browser, "//button[normalize-space(.)='Resume']")


def slide(browser: Any, label: str, key: str) -> None:
    thumb = there(browser, f"//*[normalize-space(text())='{label}']/following::*[@role='slider'][1]")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'}); arguments[0].focus()", thumb)
    thumb.send_keys(key)


def colours_of_canvas(browser: Any, picture: Path) -> int:
    """How many different colours the 3-D part of the page has; the picture is kept."""
    import imageio.v3 as imageio

    browser.save_screenshot(str(picture))
    pixels = np.asarray(imageio.imread(picture))
    width = pixels.shape[1]
    pixels = pixels[:, width * 34 // 100 : width * 66 // 100, :3].reshape(-1, 3) // 8
    return len(np.unique(pixels, axis=0))


@pytest.mark.timeout(900)  # a browser that draws without a graphics card, beside whatever else runs
def test_page_and_daemon_act_on_each_other(
    daemon: Callable[..., Any], view: Callable[..., str], browser: Any, tmp_path: Path
) -> None:
    from selenium.webdriver.common.keys import Keys

    running = daemon("crossing_car", "--speed", "1", "--link", "front=pty:./lms", "--record", "run")
    control = Path(running.ready["control"].removeprefix("unix:"))
    host = Reading(running.path("front"))
    url = view(str(control))

    # the door
    assert url.endswith(f"/{TOKEN}/")
    own = url.removesuffix(f"{TOKEN}/")
    assert answered(url) == 200
    assert answered(own) == answered(f"{own}?token=wrong") == answered(f"{own}wrong/") == 403
    assert answered(url, Origin="http://evil.example") == answered(url, Host="evil.example") == 403

    # points appear
    browser.get(url)
    until(lambda: browser.execute_script(POINTS) > 100, why="no points in the page")
    assert not [row for row in browser.get_log("browser") if row["level"] == "SEVERE"]
    assert browser.get_cookies() == []
    assert host.wall > 50

    # a button below the fog field acts on what the host receives
    press(browser, "10 m")
    until(lambda: host.wall == 0, why="the host still sees the wall in fog of 10 m")
    assert ask(control, "weather", {})["weather"]["fog"]["visibility_m"] == 10.0  # type: ignore[index, call-overload]
    press(browser, "clear")
    until(lambda: host.wall > 50, why="the fog has not gone")

    # a fault's button acts on the wire
    before = host.host.errors
    press(browser, "bad_checksum")
    until(lambda: host.host.errors > before, why="no telegram with a wrong check")

    # pause stands, resume goes on
    press(browser, "Pause")
    until(lambda: browser.find_elements("xpath", "//button[normalize-space(.)='Resume']"), why="no Resume")
    now_s, count = ask(control, "glance", {})["now_s"], host.count  # type: ignore[index, call-overload]
    PICTURES.mkdir(exist_ok=True)
    until(lambda: abs(browser.execute_script(NOW) - now_s) < 0.05, why="the page tells another time")
    assert colours_of_canvas(browser, PICTURES / "view.png") > 20
    assert ask(control, "glance", {})["now_s"] == now_s  # type: ignore[index, call-overload]
    assert host.count - count <= 1
    press(browser, "Step one scan")
    press(browser, "Step one scan")  # a scan's bytes are on the line until the next is due
    until(lambda: host.count > count, why="no scan in two steps")
    press(browser, "Resume")
    until(lambda: host.count > count + 10, why="time does not go on")

    host.end()
    assert running.stop() == 0
    until(lambda: "ended" in browser.find_element("css selector", "body").text, why="the page does not tell the end")

    # the recording
    browser.get(view(str(tmp_path / "run")))
    until(lambda: browser.execute_script(POINTS) > 100, why="no points of the recording")
    stand(browser)
    slide(browser, "At, s", Keys.END)
    slide(browser, "At, s", Keys.HOME)
    until(lambda: browser.execute_script(POINTS) == 0 and browser.execute_script(NOW) < 0.1, why="not at its beginning")


@pytest.mark.timeout(600)
def test_a_scenario_is_started_with_hosts_of_ours(view: Callable[..., str], browser: Any) -> None:
    url = view("two_sensors")
    assert url.startswith("http://127.0.0.1:")
    browser.get(url)
    count = "return [...document.querySelectorAll('.view-sensor')].filter(one => +one.dataset.points > 10).length"
    until(lambda: browser.execute_script(count) == 2, why="not both sensors have points")


@pytest.mark.timeout(600)
def test_a_scenario_stands_at_its_end_and_the_page_says_so(
    view: Callable[..., str], browser: Any, tmp_path: Path
) -> None:
    (tmp_path / "short.yaml").write_text(
        "schema: 1\nduration_s: 2\nsensors:\n  - {id: front, model: sick-lms291-s05, links: ['pty:./front']}\n"
    )
    url = view("short.yaml")
    browser.get(url)
    there(browser, "//*[contains(text(), 'The scenario ends at 2 s.')]")
    assert browser.execute_script(NOW) == 2.0
    press(browser, "Resume")
    until(lambda: browser.execute_script(NOW) > 2.0, why="time does not go on")
    press(browser, "Restart")
    until(lambda: 0.0 <= browser.execute_script(NOW) <= 2.0, why="it does not begin again")
