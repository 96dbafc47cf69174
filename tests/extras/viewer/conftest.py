"""A server of pages, and Chromium without a screen, which draws by software what a program serves."""

import re
import shutil
import subprocess
import sys
from contextlib import ExitStack

import pytest

SOFTWARE = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
WAIT_MS = 120_000


@pytest.fixture(scope="module")
def server():
    """A server on a free port of the loopback."""
    from vlp16emu.extras.viewer.page import guarded_server

    with guarded_server("127.0.0.1", 0) as server:
        yield server


@pytest.fixture(scope="module")
def browser():
    """Chromium, where it is installed."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("no chromium")
    with (
        sync_api.sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=chromium, args=SOFTWARE) as browser,
    ):
        yield browser


@pytest.fixture
def in_browser(browser):
    """Start the program with a command line that prints the address of a page; give program and page."""
    with ExitStack() as ends:

        def show(*words, width=900, height=700, scale=1.0):
            command = [sys.executable, "-m", "vlp16emu", *map(str, words)]
            program = ends.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
            ends.callback(program.terminate)
            page = browser.new_page(viewport={"width": width, "height": height}, device_scale_factor=scale)
            ends.callback(page.close)
            page.set_default_timeout(WAIT_MS)
            page.goto(re.search(r"http\S+", program.stdout.readline())[0])
            return program, page

        yield show
