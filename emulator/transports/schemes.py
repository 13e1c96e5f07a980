"""The links of a sensor: `open_link("pty:./front")` and the table of what there is.

Each scheme is opened by a function of its own module, imported when such a link is asked for: a run that uses a
pseudo-terminal loads neither pyserial nor python-can. An opener takes the text of the link, and by name what its entry
lists under `wants`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from emulator.errors import LinkError
from emulator.transports.link import Link
from emulator.transports.urls import parse_url

if TYPE_CHECKING:
    from emulator.transports.can_link import CanPorts
    from emulator.transports.loopback import Loops


@dataclass(frozen=True)
class LinkScheme:
    """One kind of link."""

    form: str
    "How it is written."
    help: str
    "One line for `lidaremu list links`."
    opener: str
    "`module:function` that opens it: (text, what `wants` names) -> Link; raises LinkError."
    check: str
    "`module:function` that judges the text alone; raises ValueError. A module without it leaves all to the opener."
    wants: tuple[str, ...] = ()
    "Arguments of `open_link` that the opener takes by name."


def _scheme(module: str, scheme: str, form: str, help_text: str, wants: tuple[str, ...] = ()) -> LinkScheme:
    place = f"emulator.transports.{module}"
    return LinkScheme(form, help_text, f"{place}:open_link_{scheme}", f"{place}:check_link_{scheme}", wants)


LINK_SCHEMES = MappingProxyType(
    {
        "pty": _scheme(
            "pseudo_terminal",
            "pty",
            "pty:PATH[?speed=strict|custom_divisor|ignore]",
            "pseudo-terminal; PATH becomes a symbolic link to it and is removed at the end",
        ),
        "serial": _scheme(
            "serial_port",
            "serial",
            "serial:DEVICE[?baud=9600&parity=N|E|O|M|S&stop=1|2]",
            "serial port or adapter; the emulated device sets its speed",
        ),
        "tcp": _scheme(
            "tcp_server",
            "tcp",
            "tcp:HOST:PORT",
            "TCP server; without HOST 127.0.0.1, *: all interfaces; port 0: any free port",
            ("serial_line",),
        ),
        "udp": _scheme(
            "udp_sender",
            "udp",
            "udp:HOST:PORT[?listen=[HOST:]PORT&ttl=N&interface=ADDRESS]",
            "sends UDP datagrams, also multicast; listen: receives datagrams of hosts",
            ("serial_line",),
        ),
        "socketcand": _scheme(
            "socketcand",
            "socketcand",
            "socketcand:HOST:PORT/CHANNEL[?bitrate=N]",
            "CAN: socketcand server for any number of standard clients; no kernel module",
            ("can_ports", "can_bitrate"),
        ),
        "slcan": _scheme(
            "slcan",
            "slcan",
            "slcan:PATH[?bitrate=N]",
            "CAN: serial CAN adapter (LAWICEL) on a pseudo-terminal",
            ("can_ports", "can_bitrate"),
        ),
        "can": _scheme(
            "can_bus",
            "can",
            "can:INTERFACE:CHANNEL[?bitrate=N&gap_us=N&KEY=VALUE...]",
            "CAN: any python-can interface: virtual, socketcan, pcan, kvaser, udp_multicast, ...",
            ("can_ports", "can_bitrate"),
        ),
        "loop": _scheme(
            "loopback",
            "loop",
            "loop:NAME",
            "in memory, for tests with a virtual clock",
            ("serial_line", "loops"),
        ),
    }
)
"Scheme -> how it is written, what it is, who opens it."


def open_link(
    url: str,
    serial_line: bool = True,
    *,
    loops: Loops | None = None,
    can_ports: CanPorts | None = None,
    can_bitrate: int | None = None,
) -> Link:
    """Open the link that `url` names.

    `serial_line`: what TCP and UDP are to this sensor. True: a serial device server in front of its line (paced, no
    connections, `LinkKind.SERIAL`); False: the sensor's own network interface (`STREAM`, `DATAGRAM`, not paced).
    `loops`: where the host's end of a `loop:` is found by its name. `can_ports`: the CAN buses of the run; sensors that
    name the same one share it. `can_bitrate`: that of the bus where the text gives none. Raises `LinkError`.
    """
    try:
        check_url(url)
    except ValueError as error:
        raise LinkError(str(error)) from None
    scheme = LINK_SCHEMES[url.partition(":")[0]]
    given: dict[str, Any] = {"serial_line": serial_line, "loops": loops, "can_ports": can_ports}
    given["can_bitrate"] = can_bitrate
    opener = _function(scheme.opener)
    if opener is None:
        raise LinkError(f"{url}: {scheme.opener} is missing from this installation")
    link: Link = opener(url, **{name: given[name] for name in scheme.wants})
    return link


def check_url(url: str) -> None:
    """Judge a link's text without opening it: `ValueError` says what was found and what is allowed."""
    scheme = LINK_SCHEMES.get(url.partition(":")[0])
    if scheme is None:
        raise ValueError(f"{url!r}: no such link; want {', '.join(entry.form for entry in LINK_SCHEMES.values())}")
    if not parse_url(url).target:
        raise ValueError(f"{url!r}: nothing after the colon; want {scheme.form}")
    check = _function(scheme.check)
    if check is not None:
        check(url)


def _function(place: str) -> Callable[..., Any] | None:
    module, _, name = place.partition(":")
    found: Callable[..., Any] | None = getattr(import_module(module), name, None)
    return found
