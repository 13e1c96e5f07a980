"""The text of a link: taken apart and checked, nothing opened.

Every fault is a `ValueError` that quotes what was found and says what is allowed; whoever read the text adds the place.
What each scheme opens stands in `schemes`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from urllib.parse import parse_qsl

from emulator.config.budgets import MOST_DIGITS

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class LinkUrl:
    """A link's text in its parts: `scheme:target?key=value&...`."""

    text: str
    scheme: str
    target: str
    options: Mapping[str, str]

    def allow(self, *keys: str) -> None:
        """Raise when an option is none of `keys`."""
        for key in self.options:
            if key not in keys:
                allowed = f"one of {', '.join(keys)}" if keys else f"no options after {self.scheme}:{self.target}"
                raise ValueError(f"{self.text!r}: unknown option {key!r}; want {allowed}")

    def choice(self, key: str, allowed: tuple[str, ...]) -> str:
        """The option's value, the first of `allowed` without it."""
        value = self.options.get(key, allowed[0])
        if value not in allowed:
            raise ValueError(f"{self.text!r}: {key}={value}; want one of {', '.join(allowed)}")
        return value

    def number(self, key: str, default: int, lowest: int, highest: int) -> int:
        """The option as a whole number in `lowest`..`highest`."""
        return _number(self.text, key, self.options.get(key, str(default)), lowest, highest)


def _number(text: str, key: str, value: str, lowest: int, highest: int) -> int:
    if not (value.isascii() and value.isdigit() and len(value) <= 12 and lowest <= int(value) <= highest):
        raise ValueError(f"{text!r}: {key} is {value!r}; want a whole number {lowest}..{highest}")
    return int(value)


def parse_url(text: str) -> LinkUrl:
    """Split a link's text; the scheme and what follows must be there, an option may stand once."""
    scheme, colon, rest = text.partition(":")
    if not colon or not scheme:
        raise ValueError(f"{text!r}; want SCHEME:..., for example pty:./front")
    if not text.isprintable():
        raise ValueError(f"{text!r}: has a character that cannot be printed; want printable text")
    target, mark, query = rest.partition("?")
    options: dict[str, str] = {}
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True, max_num_fields=16) if mark else []
    except ValueError:
        raise ValueError(f"{text!r}: {query!r} after the question mark; want KEY=VALUE, several joined by &") from None
    for key, value in pairs:
        if key in options:
            raise ValueError(f"{text!r}: option {key!r} given twice; want it once")
        options[key] = value
    return LinkUrl(text, scheme, target, MappingProxyType(options))


def host_and_port(text: str, target: str, lowest: int = 0) -> tuple[str, int]:
    """Host and port of `HOST:PORT`; no host or `localhost` is 127.0.0.1, `*` every interface, IPv6 in brackets."""
    host, colon, port = target.rpartition(":")
    if not colon:
        raise ValueError(f"{text!r}: {target!r}; want HOST:PORT, for example {LOOPBACK}:2111")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        raise ValueError(f"{text!r}: host {host!r}; want an IPv6 address in brackets, for example [::1]:2111")
    number = _number(text, "port", port, lowest, 65_535)
    return {"": LOOPBACK, "localhost": LOOPBACK, "*": "0.0.0.0"}.get(host, host), number


def join_host_port(host: str, port: int) -> str:
    """`HOST:PORT`, an IPv6 address in brackets."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def option_value(text: str) -> int | float | bool | str:
    """An option for python-can, as its own configuration reads it: a number or truth value where the text is one."""
    if text in ("true", "false"):
        return text == "true"
    if len(text) > MOST_DIGITS:  # no number of an option is as long
        return text
    for kind in (lambda given: int(given, 0), float):
        try:
            number: int | float = kind(text)
        except ValueError:
            continue
        return number
    return text
