"""A browser: Chromium without a window, driven by Selenium (extra `browser`), where both are installed.

`make test-browser` installs them; with KBSTORE_TEST_BROWSER a missing one is an error.
"""

import json
import os
import shutil

import pytest

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1280,990",
)


class Browser:
    """A browser that opens pages from files."""

    def __init__(self, driver, directory):
        self.driver = driver
        self._directory = directory

    def open(self, text, view=""):
        """Open a page, which must have no error, and request only itself."""
        path = self._directory / "page.html"
        path.write_text(text, encoding="utf-8")
        self.driver.get("about:blank")
        self.driver.get(path.as_uri() + view)
        return self

    def visit(self, address):
        self.driver.get(address)

    def run(self, script, *arguments):
        """Run a script in the page, and return what it returns."""
        return self.driver.execute_script(script, *arguments)

    def text(self, selector):
        return self.run("return document.querySelector(arguments[0]).innerText", selector)

    def jump(self, t, belief):
        self.run("kbstore.jump(arguments[0], arguments[1])", t, belief)

    def emulate(self, **features):
        media = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": media})

    def click(self, t, lane):
        """Click on a lane at a time; without a time on its label."""
        place = self.run("return kbstore.places().find((each) => each.text === arguments[0])", lane)
        x = 30 if t is None else self.run("return kbstore.x(arguments[0])", t)
        self._pointer(x, place["y"] + place["height"] / 2)

    def click_transaction(self, t):
        self._pointer(self.run("return kbstore.x(arguments[0])", t), 34)

    def _pointer(self, x, y):
        left, top = self.run(
            "const box = document.querySelector('canvas').getBoundingClientRect(); return [box.x, box.y]"
        )
        for kind, count in (("mouseMoved", 0), ("mousePressed", 1), ("mouseReleased", 1)):
            event = {"type": kind, "x": left + x, "y": top + y, "button": "left", "clickCount": count}
            self.driver.execute_cdp_cmd("Input.dispatchMouseEvent", event)
        self.settle()

    def press(self, key):
        for kind in ("keyDown", "keyUp"):
            event = {"type": kind, "key": key, **({"text": key} if len(key) == 1 and kind == "keyDown" else {})}
            self.driver.execute_cdp_cmd("Input.dispatchKeyEvent", event)
        self.settle()

    def settle(self):
        """Wait until the page has drawn."""
        self.driver.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")

    def colours(self, t, lane, width=1):
        """The colours of a line of pixels through a lane, from a time on."""
        return self.run(
            """
            const place = kbstore.places().find((each) => each.text === arguments[1]);
            const pen = document.querySelector("canvas").getContext("2d"), y = place.y + place.height / 2;
            const found = pen.getImageData(kbstore.x(arguments[0]), y, arguments[2], 1).data;
            return Array.from({ length: arguments[2] }, (_, index) => found.slice(4 * index, 4 * index + 3).join(" "));
            """,
            t,
            lane,
            width,
        )

    def errors(self):
        messages = [entry["message"] for entry in self.driver.get_log("browser")]
        # Selenium's advice for reading pixels, as `colours` does
        return [message for message in messages if "willReadFrequently" not in message]

    def requested(self):
        """The requested addresses."""
        messages = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        return [
            message["params"]["request"]["url"]
            for message in messages
            if message["method"] == "Network.requestWillBeSent"
        ]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    """A browser with a profile of its own."""
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    try:
        from selenium import webdriver
    except ImportError:
        webdriver = None
    if not (binary and driver and webdriver):
        text = "no Chromium, chromedriver or Selenium: make test-browser installs them"
        (pytest.fail if os.environ.get("KBSTORE_TEST_BROWSER") else pytest.skip)(text)
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    found = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield Browser(found, tmp_path_factory.mktemp("pages"))
    finally:
        found.quit()
