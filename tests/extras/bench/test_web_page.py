"""The page at `/` in a browser: it shows the sensor's state, and its form sets it."""

import shutil

import pytest

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
LOOKS = 3000  # at the page, 20 ms apart


@pytest.fixture(scope="module")
def browser():
    with (
        sync_api.sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"]) as started,
    ):
        yield started


class Page:
    """The page of a sensor, once it shows values."""

    def __init__(self, browser, address):
        self._page = browser.new_page()
        self._page.goto("http://{}:{}/".format(*address))
        self.wait("typeof at == 'function' && at('link').textContent == 'connected'")
        self.run, self.click, self.close = self._page.evaluate, self._page.click, self._page.close

    def type(self, selector, value):
        put = (
            "(field, value) => { field.value = value; "
            "field.dispatchEvent(new Event('input', {bubbles: true})); }"
        )
        self._page.eval_on_selector(selector, put, value)

    def wait(self, condition):
        """Wait until a condition holds in the page, whose policy forbids scripts that watch it."""
        for _ in range(LOOKS):
            if self._page.evaluate(condition):
                return
            self._page.wait_for_timeout(20)
        pytest.fail(self._page.inner_text("body"))

    def text(self, name):
        return self._page.text_content(f"#{name}")


@pytest.fixture
def page(web, browser):
    opened = Page(browser, web.address)
    yield opened
    opened.close()


def test_the_page_shows_the_state(web, page):
    """Model, serial number, speed, pulse, laser, temperatures and voltages are those of the documents; all
    settings are filled in."""
    names = ("model", "serial", "mac", "rpm", "motor", "laser", "pps", "position", "phase", "lock")
    assert [page.text(name) for name in names] == [
        *("VLP-16", "11001000000001", "60-76-88-38-00-01", "600", "On, set to 600", "On", "Locked"),
        *("49 00.00N 200 .00W", "307.55", "not locked"),
    ]
    shown = {name: float(page.text(name)) for name in ("top", "bottom", "volts", "amperes", "five")}
    assert shown == {
        "top": pytest.approx(53.1, abs=0.6),
        "bottom": pytest.approx(51.1, abs=0.6),
        "volts": pytest.approx(12.0, abs=0.1),
        "amperes": pytest.approx(0.48, abs=0.03),
        "five": pytest.approx(5.02, abs=0.02),
    }
    fields = page.run("fields.map(field => [pathOf(field) + ' ' + field.name, field.value])")
    assert dict(fields) == {
        "/cgi/setting rpm": "600", "/cgi/setting returns": "Strongest", "/cgi/setting laser": "On",
        "/cgi/setting/fov start": "0", "/cgi/setting/fov end": "359",
        "/cgi/setting/host addr": "255.255.255.255", "/cgi/setting/host dport": "2368",
        "/cgi/setting/host tport": "8308",
        "/cgi/setting/phaselock enabled": "Off", "/cgi/setting/phaselock offset": "0",
        "/cgi/setting/net dhcp": "Off", "/cgi/setting/net addr": "192.168.1.201",
        "/cgi/setting/net mask": "255.255.255.0", "/cgi/setting/net gateway": "192.168.1.1",
    }  # fmt: skip


def test_the_form_sends_what_was_changed(web, page):
    """All changed fields are set by one press, the phase in 0.01 degree; unchanged ones are not sent. The
    speed goes to its number by steps."""
    values = {
        "[name=rpm]": "900",
        "[name=returns]": "Dual",
        "[name=laser]": "Off",
        "[name=start]": "350",
        "[name=end]": "10",
        "[name=enabled]": "On",
        "[name=offset]": "123.45",
        "[name=dport]": "3000",
        "[data-path='/cgi/setting/net'] [name=addr]": "10.0.0.2",
    }
    for selector, value in values.items():
        page.type(selector, value)
    page.click("[type=submit]")
    page.wait("at('said').textContent.startsWith('Set.')")
    made = web.engine.settings
    assert (made.rpm, made.return_mode, made.laser, made.fov_deg) == (900, "dual", False, (350, 10))
    assert (made.phase_lock_deg, made.phase_lock_cdeg) == (123.45, 12_345)
    assert (made.data_port, made.position_port, made.address, made.host) == (
        3000,
        8308,
        "10.0.0.2",
        "255.255.255.255",
    )
    assert len(web.engine.changes) == 5  # one for each part of the form
    page.wait("at('laser').textContent == 'Off' && at('rpm').textContent == 900")
    assert page.text("motor") == "On, set to 900"


def test_a_refused_value_is_shown_with_its_reason(web, page):
    """What the sensor does not take is said in the page, and stays marked."""
    page.type("[data-path='/cgi/setting/host'] [name=addr]", "0.0.0.0")
    page.click("[type=submit]")
    page.wait("at('said').textContent.startsWith('addr: found')")
    assert "expected the IPv4 address of a host" in page.text("said")
    assert page.run("document.querySelectorAll('.changed').length") == 1
    assert web.engine.changes == []


def test_save_and_reset_are_buttons(web, page):
    """A value that is being typed stays; a saved setting is there after the reset; one that was set since
    is not."""
    page.type("[name=end]", "90")
    web.client.post("/cgi/setting", "rpm=300")
    page.wait("document.querySelector('[name=rpm]').value == 300")  # set from elsewhere, and shown
    assert page.run("document.querySelector('[name=end]').value") == "90"
    page.click("#save")
    page.wait("at('said').textContent == 'Saved.'")
    web.client.post("/cgi/setting", "rpm=1200")
    page.click("#reset")
    page.wait("at('said').textContent == 'The sensor starts again.'")
    assert [settings.rpm for settings in web.engine.resets] == [300]
    page.wait("document.querySelector('[name=rpm]').value == 300")


def test_the_page_says_when_nothing_answers(web, page):
    """A sensor that starts, and one whose web interface is faulty, are shown as such, and found again."""
    for name, broken, well in (("fault", 503, None), ("is_up", False, True)):
        setattr(web if name == "fault" else web.engine, name, broken)
        page.wait("at('link').textContent == 'no answer'")
        setattr(web if name == "fault" else web.engine, name, well)
        page.wait("at('link').textContent == 'connected'")
