"""A folder of pages on a local server, and Chromium to look at them."""

import functools
import http.server
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--disable-extensions")


def missing() -> str:
    """Why no browser can be driven here; empty where one can."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is not installed (pip install '.[docs]')"
    if browser() is None or shutil.which("chromedriver") is None:
        return "no Chromium with its driver (Debian: apt-get install chromium chromium-driver)"
    return ""


def browser() -> str | None:
    """The browser's program."""
    return next((found for name in BROWSERS if (found := shutil.which(name))), None)


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """The address of a folder, while it is served."""

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, format, *args):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@contextmanager
def chromium() -> Iterator:
    """A headless Chromium, which must not ask any server but this machine's."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = browser()
    for option in (*OPTIONS, "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        yield driver
    finally:
        driver.quit()


def set_size(driver, width: int, height: int) -> None:
    """The window's size in pixels; narrow ones are a phone's."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def wait_until(driver, condition, seconds: float = 60.0):
    """What the condition gives, as soon as it is true: pages go on changing after they have loaded."""
    from selenium.common.exceptions import NoSuchElementException, StaleElementReferenceException
    from selenium.webdriver.support.ui import WebDriverWait

    changing = (NoSuchElementException, StaleElementReferenceException)
    return WebDriverWait(driver, seconds, ignored_exceptions=changing).until(condition)


def visible(driver, by: str, what: str):
    """The first such element that can be seen, as soon as there is one."""
    return wait_until(driver, lambda d: next((e for e in d.find_elements(by, what) if e.is_displayed()), None))


def click(driver, by: str, what: str) -> None:
    """Click on the first such element that can be seen, as soon as it can be clicked."""
    from selenium.common.exceptions import ElementNotInteractableException

    def clicked(_):
        try:
            visible(driver, by, what).click()
        except ElementNotInteractableException:  # it moves, or is covered for a moment
            return False
        return True

    wait_until(driver, clicked)


TOO_WIDE = """
const width = document.documentElement.clientWidth;  // innerWidth grows with what stands out
const scrolls = node => node && node !== document.body
    && (['auto', 'scroll', 'hidden'].includes(getComputedStyle(node).overflowX) || scrolls(node.parentElement));
const found = [...document.querySelectorAll('article *')].filter(node => {
    const box = node.getBoundingClientRect();
    return box.width > 0 && box.right > width + 1 && !scrolls(node);
});
if (document.documentElement.scrollWidth > width) found.push(document.documentElement);
return found.map(node => node.outerHTML.slice(0, 120));
"""
"""What stands out of the window on the right, and cannot be scrolled into it."""

NOT_SHOWN = """
const empty = node => { const box = node.getBoundingClientRect(); return box.width < 2 || box.height < 2; };
const images = [...document.querySelectorAll('article img')].filter(node => node.loading !== 'lazy');
return [
    ...images.filter(image => !image.complete || image.naturalWidth === 0 || empty(image)),
    ...[...document.querySelectorAll('math')].filter(empty),
].map(node => node.outerHTML.slice(0, 120));
"""
"""Images and equations that are there, and not to be seen."""
