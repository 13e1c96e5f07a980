"""`doctor --serial`: what an adapter does. Adapters are pseudo-terminals, files as in sysfs."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from emulator.errors import LinkError
from emulator.process.clock import SystemClock
from emulator.transports import adapter_probe
from emulator.transports.adapter_probe import probe_adapter
from emulator.transports.probes import Probe
from emulator.transports.tty_modes import set_raw


class Adapter:
    """A pseudo-terminal; bridged, it gives every byte back."""

    def __init__(self, bridged: bool) -> None:
        self._master, self._slave = os.openpty()
        set_raw(self._slave)
        self.path = os.ttyname(self._slave)
        self._end, self._ring = os.pipe()
        self._thread = threading.Thread(target=self._echo if bridged else self._drain, daemon=True)
        self._thread.start()

    def _each(self) -> Iterator[bytes]:
        import select

        while True:
            ready, _, _ = select.select([self._master, self._end], [], [])
            if self._end in ready:
                return
            yield os.read(self._master, 4096)

    def _echo(self) -> None:
        for data in self._each():
            os.write(self._master, data)

    def _drain(self) -> None:
        for _ in self._each():
            pass

    def close(self) -> None:
        os.write(self._ring, b".")
        self._thread.join()
        for number in (self._master, self._slave, self._end, self._ring):
            os.close(number)


def asked(adapter: Adapter, sysfs: Path) -> dict[str, Probe]:
    try:
        return {one.name: one for one in probe_adapter(adapter.path, SystemClock(), sysfs)}
    finally:
        adapter.close()


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adapter_probe, "LOOP_S", 0.05)
    monkeypatch.setattr(adapter_probe, "PAYLOAD_S", 0.01)


def test_a_bridged_adapter_is_measured_there_and_back(tmp_path: Path) -> None:
    found = asked(Adapter(bridged=True), tmp_path)
    assert found["loop-back"].works
    assert "a byte and back: median" in found["loop-back"].detail
    assert "there and back" in found["real speed"].detail
    assert found["speeds"].detail == "taken: 9600, 19200, 38400, 57600, 115200, 500000"


def test_an_open_line_says_what_to_bridge_and_a_pty_is_no_line(tmp_path: Path) -> None:
    found = asked(Adapter(bridged=False), tmp_path)
    assert not found["loop-back"].works
    assert "nothing came back; bridge TXD and RXD" in found["loop-back"].detail
    assert not found["real speed"].works  # bytes leave a pseudo-terminal at no speed at all


@pytest.mark.parametrize(("ms", "works"), [("1", True), ("2", True), ("16", False)])
def test_an_ftdis_latency_timer_is_judged(tmp_path: Path, ms: str, works: bool) -> None:
    adapter = Adapter(bridged=False)
    place = tmp_path / os.path.basename(adapter.path) / "device" / "latency_timer"
    place.parent.mkdir(parents=True)
    place.write_text(f"{ms}\n")
    found = asked(adapter, tmp_path)["latency timer"]
    assert found.works is works
    assert found.detail.startswith(f"{ms} ms")
    assert (f"echo 1 > {place}" in found.detail) is not works


def test_no_device_is_a_line_not_a_traceback(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="cannot open /no/such: No such file"):
        probe_adapter("/no/such", SystemClock(), tmp_path)
