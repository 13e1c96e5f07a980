"""Texts of links: what is taken, and what every refusal says."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from emulator.errors import LinkError
from emulator.transports.schemes import LINK_SCHEMES, check_url, open_link
from emulator.transports.urls import host_and_port, parse_url


@pytest.mark.parametrize(
    "url",
    [
        "pty:./front",
        "pty:/with space",
        "pty:front?speed=strict",
        "pty:front?speed=custom_divisor",
        "pty:front?speed=ignore",
        "serial:/dev/ttyUSB0",
        "serial:/dev/ttyUSB0?baud=500000&parity=N",
        "serial:/dev/serial/by-id/usb-FTDI_Chipi-X-if00-port0?stop=2",
        "tcp::2111",
        "tcp:127.0.0.1:0",
        "tcp:localhost:49152",
        "tcp:*:2111",
        "tcp:[::1]:2111",
        "udp:239.1.2.3:2368?ttl=4&interface=127.0.0.1",
        "udp:127.0.0.1:2368?listen=0",
        "udp:127.0.0.1:2368?listen=0.0.0.0:2369",
        "loop:front",
    ],
)
def test_good_texts_are_taken(url: str) -> None:
    check_url(url)


@pytest.mark.parametrize(
    ("url", "found", "allowed"),
    [
        ("", "''", "pty:PATH"),
        ("front", "'front'", "pty:PATH"),
        ("ptty:./front", "'ptty:./front'", "tcp:HOST:PORT"),
        ("pty:", "'pty:'", "pty:PATH"),
        ("pty:front?speed=slow", "speed=slow", "strict, custom_divisor, ignore"),
        ("pty:front?sped=strict", "unknown option 'sped'", "speed"),
        ("pty:front?speed=strict&speed=ignore", "given twice", "once"),
        ("pty:front?speed", "'speed' after the question mark", "KEY=VALUE"),
        ("pty:a\nb", "cannot be printed", "printable"),
        ("pty:a\0b", "cannot be printed", "printable"),
        ("pty:\ud800", "cannot be printed", "printable"),
        ("serial:/dev/ttyS0?baud=fast", "baud is 'fast'", "50..20000000"),
        ("serial:/dev/ttyS0?baud=0", "baud is '0'", "50..20000000"),
        ("serial:/dev/ttyS0?baud=9600.0", "baud is '9600.0'", "whole number"),
        ("serial:/dev/ttyS0?parity=X", "parity=X", "N, E, O, M, S"),
        ("tcp:2111", "'2111'", "HOST:PORT"),
        ("tcp:127.0.0.1:70000", "port is '70000'", "0..65535"),
        ("tcp:127.0.0.1:²", "port is '²'", "whole number"),
        ("tcp:::1:2111", "host '::1'", "brackets"),
        ("tcp:127.0.0.1:1?nagle=1", "unknown option 'nagle'", "no options"),
        ("udp:127.0.0.1:0", "port is '0'", "1..65535"),
        ("udp:127.0.0.1:1?listen=x", "port is 'x'", "0..65535"),
        ("udp:127.0.0.1:1?ttl=256", "ttl is '256'", "0..255"),
        ("udp:239.1.1.1:1?interface=eth0", "interface=eth0", "IPv4 address"),
        ("loop:x?y=1", "unknown option 'y'", "no options"),
    ],
)
def test_a_refusal_says_what_was_found_and_what_is_allowed(url: str, found: str, allowed: str) -> None:
    with pytest.raises(ValueError, match=r"want ") as refusal:
        check_url(url)
    assert found in str(refusal.value)
    assert allowed in str(refusal.value)
    with pytest.raises(LinkError):
        open_link(url)


@pytest.mark.parametrize(
    ("target", "host", "port"),
    [
        (":2111", "127.0.0.1", 2111),
        ("localhost:1", "127.0.0.1", 1),
        ("*:1", "0.0.0.0", 1),
        ("[fe80::1]:5", "fe80::1", 5),
        ("sick.local:5", "sick.local", 5),
    ],
)
def test_without_a_host_it_is_the_loopback(target: str, host: str, port: int) -> None:
    assert host_and_port("tcp:" + target, target) == (host, port)


@given(
    st.sampled_from(["pty", "serial", "tcp", "udp", "loop", ""]),
    st.text(max_size=30) | st.text("?&=:[]*%/.-0123456789abspeedlistenttl", max_size=40),
)
def test_any_text_is_taken_or_refused_with_what_is_wanted(scheme: str, rest: str) -> None:
    said = "want "
    try:
        check_url(f"{scheme}:{rest}")
    except ValueError as refusal:
        said = str(refusal)
    assert "want " in said


def test_a_text_falls_into_its_parts() -> None:
    url = parse_url("serial:/dev/ttyUSB0?baud=500000&parity=N")
    assert (url.scheme, url.target, dict(url.options)) == ("serial", "/dev/ttyUSB0", {"baud": "500000", "parity": "N"})


def test_the_table_says_how_each_link_is_written() -> None:
    assert set(LINK_SCHEMES) >= {"pty", "serial", "tcp", "udp", "loop", "can", "socketcand", "slcan"}
    for name, scheme in LINK_SCHEMES.items():
        assert scheme.form.startswith(name + ":")
        assert scheme.help
        assert "\n" not in scheme.help
