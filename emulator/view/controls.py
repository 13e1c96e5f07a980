"""What the user presses: time, weather and faults. Every order goes to the source in a thread of its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import viser

from emulator.errors import EmulatorError
from emulator.output.sanitizing import html, visible
from emulator.runtime.order_words import parameters_of
from emulator.view.drawing import inset
from emulator.view.frames import Frame, Source
from emulator.view.sky import CLEAR_M, FOG_CHOICES, THICK_M, faults_of, fog_field_m, fog_table, reported

QUIET_LOOKS = 8
"Looks after the user's last move of a slider until the sliders follow the daemon again."
COMMON: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "Light": ("dead_laser", "dirty_window"),
        "Scan": ("mirror_stuck", "frozen_scan"),
        "Telegram": ("bad_checksum", "drop_telegram"),
        "Link": ("garbage", "unplug"),
        "Device": ("reboot", "hang"),
    }
)
"Faults with a button of their own; they need no key."


class Orders:
    """Sends orders one after the other; of the same kind only the newest that waits."""

    def __init__(self, source: Source, failed: Callable[[str], None]) -> None:
        self._source = source
        self._failed = failed
        self._waiting: dict[str, tuple[str, Mapping[str, Any], Callable[[Any], None]]] = {}
        self._bell: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._lock = threading.Lock()
        threading.Thread(target=self._work, name="lidaremu-orders", daemon=True).start()

    def send(
        self, key: str, method: str, params: Mapping[str, Any], then: Callable[[Any], None] = lambda result: None
    ) -> None:
        """Have it sent; takes the place of one with the same `key` that has not been sent yet."""
        with self._lock:
            fresh = key not in self._waiting
            self._waiting[key] = (method, params, then)
        if fresh:
            self._bell.put(key)

    def _work(self) -> None:
        while True:
            key = self._bell.get()
            with self._lock:
                method, params, then = self._waiting.pop(key)
            try:
                then(self._source.order(method, params))
            except EmulatorError as error:
                self._failed(str(error))


class Controls:
    """The folders Time, Weather and Faults."""

    def __init__(self, server: viser.ViserServer, source: Source) -> None:
        self._server = server
        self._source = source
        self._orders = Orders(source, self._complain)
        self.over = False
        "The page is being closed."
        self._quiet = 0
        self._settled: dict[int, Any] = {}
        "Value of each slider, by identity, that we gave it or that its order was made of."
        self._weather: dict[str, Any] = {}
        self._faults: list[Mapping[str, Any]] = []
        self._shown: dict[str, Any] = {}
        self._build_time()
        if source.length_s is None:
            self._build_weather()
            self._build_faults()
            self._orders.send("weather?", "weather", {}, self._take_weather)

    def _complain(self, text: str) -> None:
        if self.over:
            return
        for client in self._server.get_clients().values():
            client.add_notification("Not done", visible(text), color="red", auto_close_seconds=6.0)
        self._answer.content = inset(f'<div style="color:#e57373;font-size:12px">{html(text)}</div>')

    # ------------------------------------------------------------ time

    def _build_time(self) -> None:
        gui, length_s = self._server.gui, self._source.length_s
        self._answer = gui.add_html("")
        with gui.add_folder("Time"):
            self._moving = gui.add_button("Pause")
            self._step = gui.add_button("Step one scan")
            self._again: Any = None
            if self._source.can_restart:
                self._again = gui.add_button("Restart", hint="Begin again at 0 s")
                self._again.on_click(lambda _event: self._orders.send("restart", "restart", {}))
            self._speed = gui.add_dropdown(
                "Speed", ("fastest", "0.1", "0.25", "0.5", "1", "2", "5", "10"), initial_value="1"
            )
            if length_s is not None:
                self._seek: Any = gui.add_slider("At, s", 0.0, max(0.01, round(length_s, 3)), 0.01, 0.0)
                self._seek.on_update(self._sought)
        self._moving.on_click(
            lambda _event: self._orders.send("pause", "resume" if self._moving.label == "Resume" else "pause", {})
        )
        self._step.on_click(lambda _event: self._orders.send("step", "step", {"scans": 1}))
        self._speed.on_update(self._sped)

    def _sped(self, event: Any) -> None:
        if event.client is not None:
            value = self._settle(self._speed)
            self._orders.send("speed", "speed", {"x": 0 if value == "fastest" else float(value)})

    def _sought(self, event: Any) -> None:
        if event.client is not None:
            self._quiet = 3
            self._orders.send("seek", "seek", {"to_s": self._settle(self._seek)})

    # ------------------------------------------------------------ weather

    def _build_weather(self) -> None:
        gui = self._server.gui
        with gui.add_folder("Weather"):
            self._fog = gui.add_number(
                "Fog visibility, m", CLEAR_M, min=THICK_M, max=CLEAR_M, step=10.0,
                hint=f"Meteorological optical range; {CLEAR_M:g}: no fog",
            )  # fmt: skip
            self._fogs = gui.add_button_group("Fog", tuple(FOG_CHOICES))
            self._rain = gui.add_slider("Rain, mm/h", 0.0, 100.0, 0.5, 0.0)
            self._snow = gui.add_slider("Snow, mm/h", 0.0, 50.0, 0.5, 0.0)
            self._sun = gui.add_checkbox("Sun", False)
            self._height = gui.add_slider("Sun elevation, deg", 0.0, 90.0, 1.0, 45.0)
            self._sky = gui.add_html("")

        def ordered(key: str, table: Callable[[], Mapping[str, Any]], *handles: Any) -> Callable[[Any], None]:
            def moved(event: Any) -> None:
                if event.client is not None:
                    self._quiet = QUIET_LOOKS
                    for handle in handles:
                        self._settle(handle)
                    self._orders.send(key, "weather", table(), self._take_weather)

            return moved

        def falling(value: float) -> Mapping[str, Any] | None:
            return {"rate_mm_h": float(value)} if value else None

        def fog() -> Mapping[str, Any]:
            return {"fog": fog_table(self._fog.value)}

        def chosen(event: Any) -> None:
            self._quiet = QUIET_LOOKS
            field: Any = self._fog  # its setter is untyped
            field.value = FOG_CHOICES[event.target.value]
            self._settle(self._fog)
            self._orders.send("fog", "weather", fog(), self._take_weather)

        def sun() -> Mapping[str, Any]:
            return {"sun": {"elevation_deg": float(self._height.value)} if self._sun.value else None}

        self._fog.on_update(ordered("fog", fog, self._fog))
        self._fogs.on_click(chosen)
        self._rain.on_update(ordered("rain", lambda: {"rain": falling(self._rain.value)}, self._rain))
        self._snow.on_update(ordered("snow", lambda: {"snow": falling(self._snow.value)}, self._snow))
        self._sun.on_update(ordered("sun", sun, self._sun, self._height))
        self._height.on_update(ordered("sun", sun, self._sun, self._height))

    @property
    def weather(self) -> Mapping[str, Any]:
        """What holds, as last heard."""
        return self._weather

    def _take_weather(self, answer: Any) -> None:
        self._weather = answer["weather"]

    # ------------------------------------------------------------ faults

    def _build_faults(self) -> None:
        from emulator.faults.catalogue import kinds

        gui = self._server.gui
        self._kinds = kinds()
        self._targets = {one.id: one for one in self._source.scenario.sensors}
        names = list(self._targets)
        with gui.add_folder("Faults"):
            self._on = gui.add_dropdown("On", names)
            self._do = gui.add_dropdown("Fault", self._known(names[0]))
            self._keys = gui.add_text("Keys", "", hint="KEY=VALUE, separated by spaces; empty: defaults")
            self._start = gui.add_button("Start this fault", color="red")
            self._end = gui.add_button("End all faults")
            self._active = gui.add_html("")
            self._about = gui.add_html("")
            with gui.add_folder("At once", expand_by_default=True):
                for title, common in COMMON.items():
                    gui.add_button_group(title, [one for one in common if one in self._kinds]).on_click(self._at_once)
        self._on.on_update(lambda _event: self._offer())
        self._do.on_update(lambda _event: self._describe())
        self._start.on_click(lambda _event: self._start_chosen())
        self._end.on_click(lambda _event: self._end_all())
        self._describe()

    def _known(self, sensor: str) -> tuple[str, ...]:
        """Faults that this sensor can have."""
        from emulator.faults.reading import target_of

        one = self._targets[sensor]
        target = target_of(one.id, one.model, one.links, one.device)
        found = [
            name
            for name, kind in self._kinds.items()
            if kind.is_for(target.family)
            and (not kind.links or set(kind.links) & set(target.links))
            and target.sees in kind.sees
        ]
        return tuple(sorted(found)) or ("none",)

    def _offer(self) -> None:
        self._do.options = self._known(self._on.value)
        self._describe()

    def _describe(self) -> None:
        from emulator.faults.catalogue import keys_of

        kind = self._kinds.get(self._do.value)
        if kind is None:
            return
        keys = "".join(
            f"<div><b>{html(row['key'])}</b> = {html(row['default'])} <i>({html(row['allowed'])})</i></div>"
            for row in keys_of(kind)
        )
        self._about.content = inset(f'<div style="font-size:11px">{html(kind.summary)}{keys}</div>')

    def _start_chosen(self) -> None:
        import click

        try:
            keys = parameters_of(tuple(self._keys.value.split()))
        except click.ClickException as error:
            self._complain(error.format_message())
            return
        self._begin(self._on.value, self._do.value, keys)

    def _begin(self, sensor: str, name: str, keys: Mapping[str, Any]) -> None:
        self._answer.content = ""
        self._orders.send(f"fault {name}", "fault", {"on": sensor, "do": name} | dict(keys), self._take_faults)

    def _at_once(self, event: Any) -> None:
        self._begin(self._on.value, event.target.value, {})

    def _end_all(self) -> None:
        self._orders.send("clear", "fault_clear", {}, self._take_faults)

    def _take_faults(self, answer: Any) -> None:
        if "faults" in answer:
            self._faults = answer["faults"]
        else:
            self._orders.send("faults?", "faults", {}, self._take_faults)

    # ------------------------------------------------------------ after each look

    def follow(self, frame: Frame) -> None:
        """Buttons and sliders as the source has them."""
        label = "Resume" if frame.paused else "Pause"
        if self._moving.label != label:
            self._moving.label = label
        usable = frame.virtual and not frame.ended
        for handle in (self._moving, self._step, self._speed):
            if handle.disabled == usable:
                handle.disabled = not usable
        self._set("speed", self._speed, "fastest" if frame.speed is None else f"{frame.speed:g}")
        self._quiet = max(0, self._quiet - 1)
        if self._source.length_s is not None:
            if not self._quiet:
                self._set("seek", self._seek, round(min(frame.now_s, self._source.length_s), 2))
            return
        if frame.ended:
            return
        if not self._quiet:
            self._orders.send("weather?", "weather", {}, self._take_weather)
            self._show_weather()
            self._orders.send("faults?", "faults", {}, self._take_faults)
        for key, panel, text in (
            ("sky", self._sky, reported(self._weather)),
            ("faults", self._active, faults_of(self._faults)),
        ):
            if self._shown.get(key) != text:
                self._shown[key] = text
                panel.content = inset(text)

    def _show_weather(self) -> None:
        table = self._weather
        sun = table.get("sun") or {}
        self._set("fog", self._fog, fog_field_m(table))
        self._set("rain", self._rain, min(100.0, (table.get("rain") or {}).get("rate_mm_h", 0.0)))
        self._set("snow", self._snow, min(50.0, (table.get("snow") or {}).get("rate_mm_h", 0.0)))
        self._set("sun", self._sun, bool(sun))
        if sun:
            self._set("height", self._height, max(0.0, sun.get("elevation_deg", 45.0)))

    def _set(self, key: str, handle: Any, value: Any) -> None:
        """Only what has changed: a value set again would take the user's hand off the slider.

        Nor where the user has moved it and the order that reports so is still to come: it would be made of our value.
        """
        if key == "speed" and value not in handle.options:
            handle.options = (*handle.options, value)
        now = handle.value
        if now != value and now == self._settled.setdefault(id(handle), now):
            handle.value = value
            self._settled[id(handle)] = handle.value

    def _settle(self, handle: Any) -> Any:
        """The value that the user has given it."""
        self._settled[id(handle)] = handle.value
        return self._settled[id(handle)]
