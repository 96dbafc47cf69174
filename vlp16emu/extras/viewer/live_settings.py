"""Controls for the settings of a streaming sensor, on its page.

They act as a client of the sensor's web interface.
"""

import json
import time
from collections.abc import Callable
from contextlib import closing
from functools import partial
from html import escape
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from threading import Event, Thread
from typing import Any, NamedTuple

import viser

from vlp16emu.extras.viewer.layers import html_box
from vlp16emu.sensor.settings import LEAST_RPM, MOST_RPM, RPM_STEP
from vlp16emu.trees import Tree
from vlp16emu.types import ReturnMode

_POLL_S = 1.0  # time between readings of the settings, which events and other clients change too
_CALM_S = 0.25  # time for which a dragged control rests before its value is sent
_TIMEOUT_S = 3.0
_MOST_BYTES = 10_000  # limit of an answer, which has some 400 bytes
_FORM = "/cgi/setting"
_RPM = tuple(str(rpm) for rpm in range(LEAST_RPM, MOST_RPM + 1, RPM_STEP))
_MODES = tuple(mode.capitalize() for mode in ReturnMode)


class _Control(NamedTuple):
    """A control, and its key in the forms and the document of the web interface.

    The keys are those of 63-9243 Rev D, section 10.2.
    """

    handle: Any  # of viser, with `value`
    table: str  # table of the key in the document, and end of the form's path; empty for the outermost
    key: str
    to_form: Callable[[Any], str]  # converts a value of the control to the text of the form
    to_control: Callable[[Any], Any]  # converts a value of the document to that of the control

    def value_in(self, settings: Tree) -> Any:
        """Return the control's value in a document of settings."""
        table = settings[self.table] if self.table else settings
        return self.to_control(table[self.key])


def _switch_text(is_on: bool) -> str:
    return "on" if is_on else "off"


def _is_on(text: str) -> bool:
    return text == "On"


def _centidegrees_text(angle_deg: float) -> str:
    return str(round(100 * angle_deg))


def _degrees(centidegrees_text: str) -> float:
    return int(centidegrees_text) / 100


class SettingsPanel:
    """Controls of one sensor, and the thread that sends and reads its settings.

    Parameters
    ----------
    server : page
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._address: tuple[str, int] | None = None
        self._touched = dict[int, Any]()
        """Values of controls that a user has moved, by the index of the control."""
        self._wake = Event()
        self._over = False
        self._loop = server.get_event_loop()
        gui = server.gui
        with gui.add_folder("Sensor settings"):
            rpm = gui.add_dropdown("rpm", _RPM, initial_value="600")
            mode = gui.add_dropdown("return mode", _MODES)
            laser = gui.add_checkbox("laser", initial_value=True)
            start = gui.add_slider("FOV from, deg", 0, 359, 1, 0)
            end = gui.add_slider("FOV to, deg", 0, 359, 1, 359)
            lock = gui.add_checkbox("phase lock", initial_value=False)
            phase = gui.add_slider("phase, deg", 0.0, 359.0, 1.0, 0.0)
            self._text = gui.add_html("")
        self._controls = (
            _Control(rpm, "", "rpm", str, str),
            _Control(mode, "", "returns", str, str),
            _Control(laser, "", "laser", _switch_text, _is_on),
            _Control(start, "fov", "start", str, int),
            _Control(end, "fov", "end", str, int),
            _Control(lock, "phaselock", "enabled", _switch_text, _is_on),
            _Control(phase, "phaselock", "offset", _centidegrees_text, _degrees),
        )
        for index, control in enumerate(self._controls):
            control.handle.disabled = True
            control.handle.on_update(partial(self._touch, index))
        self._say("settings are fixed: this stream has no web interface")
        self._thread = Thread(target=self._run, name="settings", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop the thread, after a request that is under way."""
        self._over = True
        self._wake.set()
        self._thread.join()

    def connect(self, address: tuple[str, int] | None) -> None:
        """Control the sensor whose web interface is at a host and port; None for a stream without one."""
        if address == self._address:
            return
        self._address = address
        for control in self._controls:
            control.handle.disabled = address is None
        if address is not None:
            self._say(f"set over http://{address[0]}:{address[1]}/, as any client does")
        self._wake.set()

    async def _touch(self, index: int, event: viser.GuiEvent[Any]) -> None:
        """Keep the value of a control for the sensor, if a client has moved it.

        As a coroutine it runs in the event loop of the page, right where the control gets the value, and so
        does `_show`: a setting that is shown never replaces a moved value that is not kept yet.
        """
        if event.client_id is not None:  # not by `_show`
            self._touched[index] = event.target.value
            self._wake.set()

    def _run(self) -> None:
        while not self._over:
            self._wake.wait(_POLL_S)
            while self._wake.is_set():
                self._wake.clear()
                time.sleep(_CALM_S)
            try:
                self._exchange()
            except (TypeError, OverflowError):  # a client may send any value
                self._say("no such setting")
            except (OSError, HTTPException, ValueError, KeyError):  # it restarts, or an event makes it fail
                self._say("the web interface of the sensor does not answer")

    def _exchange(self) -> None:
        """Send the controls that were moved, then show the settings in force."""
        if self._address is None:
            return
        while self._touched:
            index = next(iter(self._touched))
            control = self._controls[index]
            body = f"{control.key}={control.to_form(self._touched.pop(index))}"
            answer = self._ask("POST", f"{_FORM}/{control.table}".rstrip("/"), body)
            refusal = answer.get("ignored") or answer.get("error")
            self._say(str(refusal) if refusal else f"set {control.table} {body}")
        settings = self._ask("GET", "/cgi/settings.json")
        values = [control.value_in(settings) for control in self._controls]
        if not self._wake.is_set():  # else a control is being moved
            self._loop.call_soon_threadsafe(self._show, values)

    def _ask(self, method: str, path: str, body: str | None = None) -> Tree:
        assert self._address is not None
        headers = {"Content-Type": "application/x-www-form-urlencoded"} if body else {}
        with closing(HTTPConnection(*self._address, timeout=_TIMEOUT_S)) as connection:
            connection.request(method, path, body, headers)
            answer = connection.getresponse()
            content = answer.read(_MOST_BYTES)
        tree: Tree = {} if answer.status == HTTPStatus.NO_CONTENT else json.loads(content)
        return tree

    def _show(self, values: list[Any]) -> None:
        """Move the controls that no user has moved to the values that the sensor has."""
        for index, (control, value) in enumerate(zip(self._controls, values, strict=True)):
            if index not in self._touched:
                options = getattr(control.handle, "options", (value,))
                if value not in options:  # a scene may have a speed that the web interface does not set
                    control.handle.options = (*options, value)
                control.handle.value = value

    def _say(self, line: str) -> None:
        self._text.content = html_box([escape(line)])
