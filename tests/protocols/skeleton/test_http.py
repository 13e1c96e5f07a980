"""Requests of HTTP in any chunking, and what is none; replies byte by byte."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols.session import DropReason
from protocols.skeleton.http import LONGEST, HttpRequests, NoRequest, last, page, read
from protocols.skeleton.receiving import Fault

GET = b"GET /a?b=1&c HTTP/1.1\r\n\r\n"
POST = b"POST /x HTTP/1.1\r\nhost: lidar:80\r\nCONTENT-length:  3 \r\n\r\nabc"
CHUNKED = b"PUT /x HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n2\r\nab\r\n1\r\nc\r\n0\r\n\r\n"


def asked(item: bytes | Fault) -> tuple[bytes, bytes, bytes, str]:
    assert isinstance(item, bytes)
    found = read(item)
    assert found.size == len(item)
    return found.code, found.query, found.body, found.host


@pytest.mark.parametrize(
    ("version", "fields", "ends"),
    [
        (b"1.1", b"", False),
        (b"1.1", b"Connection: keep-alive\r\n", False),
        (b"1.1", b"Connection: close\r\n", True),
        (b"1.1", b"cOnnection: Close\r\n", True),
        (b"1.0", b"", True),
    ],
)
def test_a_connection_ends_with_the_reply_where_its_client_says_so(version: bytes, fields: bytes, ends: bool) -> None:
    assert read(b"GET /a HTTP/" + version + b"\r\n" + fields + b"\r\n").last == ends


def test_the_last_reply_says_that_it_is_the_last() -> None:
    assert last(page(204)) == b"HTTP/1.1 204 No Content\r\nConnection: close\r\n\r\n"
    said = last(page(200, b"a\r\n\r\nconnection: b", fields=[("Connection", "keep-alive")]))
    assert said.count(b"Connection: close\r\n") == 1
    assert b"keep-alive" not in said
    assert said.endswith(b"\r\n\r\na\r\n\r\nconnection: b")


@pytest.mark.parametrize("cut", [1, 2, 3, 7, 64, 10_000])
def test_requests_in_any_chunking_one_after_another(cut: int) -> None:
    requests, stream, found = HttpRequests(LONGEST), GET + POST + CHUNKED + GET, []
    for at in range(0, len(stream), cut):
        found += requests.feed(stream[at : at + cut])
    assert [asked(one) for one in found] == [
        (b"GET /a", b"b=1&c", b"", ""),
        (b"POST /x", b"", b"abc", "lidar:80"),
        (b"PUT /x", b"", b"abc", ""),
        (b"GET /a", b"b=1&c", b"", ""),
    ]
    assert not requests


@pytest.mark.parametrize(
    "wrong",
    [
        b"\r\n\r\n", b"\x00\xff\r\n\r\n", b"GET\r\n\r\n", b"GET / FTP/1.0\r\n\r\n", b"GET /a b HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost : x\r\n\r\n", b"GET / HTTP/1.1\r\nHost: x\r\nHost: y\r\n\r\n",
        b"GET / HTTP/1.1\r\nContent-Length: -4\r\n\r\n", b"GET / HTTP/1.1\r\nContent-Length: 8192\r\n\r\n",
        b"GET / HTTP/1.1\r\nContent-Length: 99999999999999999999999\r\n\r\n",
        b"GET / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 2\r\n\r\n",
        b"GET / HTTP/1.1\r\nTransfer-Encoding: gzip\r\n\r\n", b"GET / HTTP/1.1\r\n: x\r\n\r\n",
        b"PUT / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\nzz\r\n\r\n"[:-6],
    ],
)  # fmt: skip
def test_what_is_no_request_is_said_so_and_the_next_one_is_found(wrong: bytes) -> None:
    requests = HttpRequests(LONGEST)
    if b"chunked" in wrong:
        assert requests.feed(wrong) == []
        (fault, *_) = requests.feed(b"zz\r\n")
    else:
        (fault, found) = requests.feed(wrong + GET)
        assert asked(found) == (b"GET /a", b"b=1&c", b"", "")
    assert isinstance(fault, NoRequest)
    assert (fault.reason, fault.whole) == (DropReason.BAD_LENGTH, True)
    assert fault.detail


def test_a_head_without_end_is_overlong() -> None:
    (fault,) = HttpRequests(LONGEST).feed(b"GET /" + b"x" * LONGEST)
    assert isinstance(fault, Fault)
    assert fault.reason is DropReason.OVERLONG


@given(
    st.lists(st.sampled_from([GET, POST, CHUNKED, b"\r\n", b"\n", b" ", b"HTTP/1.1", b"Expect: 100-continue\r\n",
                              b"Upgrade: h2c\r\n", b"CONNECT x:1 HTTP/1.1\r\n\r\n", b"Connection: close\r\n"])
             | st.binary(max_size=12), max_size=12),
    st.integers(1, 40),
)  # fmt: skip
def test_nothing_that_arrives_raises_or_is_counted_twice(parts: list[bytes], cut: int) -> None:
    requests, stream, taken = HttpRequests(LONGEST), b"".join(parts), 0
    for at in range(0, len(stream), cut):
        for item in requests.feed(stream[at : at + cut]):
            taken += len(item) if isinstance(item, bytes) else item.count
            if isinstance(item, bytes):
                read(item)
    taken += sum(one.count for one in requests.expire() if isinstance(one, Fault))
    assert taken == len(stream)


def test_replies_byte_by_byte() -> None:
    assert page(200, b"OK") == b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 2\r\n\r\nOK"
    assert page(405, b"{}", "application/json", (("Server", "nginx"), ("Connection", "keep-alive"))) == (
        b"HTTP/1.1 405 Method Not Allowed\r\nServer: nginx\r\nConnection: keep-alive\r\n"
        b"Content-Type: application/json\r\nContent-Length: 2\r\n\r\n{}"
    )
    # the specification's worked message of an Ouster
    assert page(204, fields=(("Server", "nginx"), ("Connection", "keep-alive"))) == (
        b"HTTP/1.1 204 No Content\r\nServer: nginx\r\nConnection: keep-alive\r\n\r\n"
    )
