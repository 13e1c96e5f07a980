"""Values in CoLa telegrams: one layout, written in either dialect and read from either.

A layout is a line of types; `[...]` is a repetition behind its 16-bit count, 0 or 1 of an optional part:

    u8 u16 u32 i8 i16 i32 f32   numbers; p32 an i32 whose text always has eight digits
    str                         length (16 bits) and text
    s4 s5                       so many characters
    u8* u16*                    numpy array behind its 16-bit count
    *                           bytes to the end; in CoLa-A as hexadecimal digits

CoLa-B: big endian, without separators. CoLa-A: upper-case hexadecimal, a blank between two; negative numbers in two's
complement; hosts may write a number with a sign, which is decimal then. Belongs here: values, and what passwords
become. Not: names, frames.
"""

from __future__ import annotations

import hashlib
import math
import re
import struct
from collections.abc import Iterator, Sequence
from enum import IntEnum
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocols.errors import EncodeError

ASCII, BINARY = b"A", b"B"
"The dialects."
STX, ETX = b"\x02", b"\x03"
"They bound a telegram in CoLa-A."

Node = str | tuple[Any, ...]
INTEGERS = {"u8": 1, "u16": 2, "u32": 4, "i8": 1, "i16": 2, "i32": 4, "p32": 4}
ARRAYS = {"u8*": ">u1", "u16*": ">u2"}
BLANK = 0x20
HEX, DECIMAL = re.compile(rb"[0-9A-Fa-f]{1,40}"), re.compile(rb"[+-][0-9]{1,40}")


class Code(IntEnum):
    """Error codes of `sFA`, those that our devices never send included."""

    OK = 0
    METHOD_DENIED = 1
    METHOD_UNKNOWN = 2
    VARIABLE_UNKNOWN = 3
    CONDITION_FAILED = 4
    INVALID_DATA = 5
    UNKNOWN_ERROR = 6
    TOO_MUCH = 7
    TOO_LITTLE = 8
    UNKNOWN_TYPE = 9
    WRITE_DENIED = 0xA
    UNKNOWN_SERVER_COMMAND = 0xB
    COMMAND_UNKNOWN = 0xC
    BUSY = 0xD
    OUT_OF_BOUNDS = 0xE
    EVENT_UNKNOWN = 0xF
    VALUE_OVERFLOW = 0x10
    INVALID_CHARACTER = 0x11
    NO_MESSAGE = 0x12
    NO_ANSWER_MESSAGE = 0x13
    INTERNAL_ERROR = 0x14
    HUB_ADDRESS_CORRUPTED = 0x15
    HUB_ADDRESS_NOT_DECODABLE = 0x16
    HUB_ADDRESS_TOO_LONG = 0x17
    HUB_ADDRESS_WITHOUT_BLANK = 0x18
    ASYNCHRONOUS_SUPPRESSED = 0x19
    COMPLEX_ARRAYS_UNSUPPORTED = 0x1A


class Rejected(Exception):
    """Arguments that do not fit their layout."""

    def __init__(self, code: Code) -> None:
        super().__init__(code.name)
        self.code = code


@cache
def layout(text: str) -> tuple[Node, ...]:
    """The nodes of a layout: types, and tuples of what is repeated."""
    words = iter(text.replace("[", " [ ").replace("]", " ] ").split())
    return tuple(_nodes(words))


def _nodes(words: Iterator[str]) -> Iterator[Node]:
    for word in words:
        if word == "]":
            return
        yield tuple(_nodes(words)) if word == "[" else word


# ---------------------------------------------------------------- writing


def encode(text: str, dialect: bytes, values: Sequence[Any]) -> bytes:
    """Arguments of a layout, without the blank before them. Raises `EncodeError` for what does not fit."""
    parts: list[bytes] = []
    _put(layout(text), values, parts, dialect == ASCII)
    return (b" " if dialect == ASCII else b"").join(parts)


def _put(nodes: tuple[Node, ...], values: Sequence[Any], parts: list[bytes], text: bool) -> None:
    if len(nodes) != len(values):
        raise EncodeError(f"{len(values)} values; want {len(nodes)}")
    for node, value in zip(nodes, values, strict=True):
        if isinstance(node, tuple):
            parts.append(_number("u16", len(value), text))
            for one in value:
                _put(node, one, parts, text)
        elif node in INTEGERS:
            parts.append(_number(node, value, text))
        elif node == "f32":
            word = struct.pack(">f", value)
            parts.append(word.hex().upper().encode() if text else word)
        elif node == "*":
            parts.append(value.hex().upper().encode() if text else value)
        elif node in ARRAYS:
            numbers = np.asarray(value).astype(ARRAYS[node])
            parts.append(_number("u16", len(numbers), text))
            if not text:
                parts.append(numbers.tobytes())
            elif len(numbers):
                parts.append(" ".join(map("{:X}".format, numbers.tolist())).encode())
        else:
            _put_text(node, value.encode("latin-1", "replace"), parts, text)


def _put_text(node: str, raw: bytes, parts: list[bytes], text: bool) -> None:
    if node == "str":
        parts.append(_number("u16", len(raw), text))
        if raw or not text:
            parts.append(raw)
    elif len(raw) != int(node[1:]):
        raise EncodeError(f"{raw!r}; want {node[1:]} characters")
    else:
        parts.append(raw)


def _number(node: str, value: int, text: bool) -> bytes:
    size = INTEGERS[node]
    low, high = (0, 1 << 8 * size) if node[0] == "u" else (-(1 << 8 * size - 1), 1 << 8 * size - 1)
    if not low <= value < high:
        raise EncodeError(f"{value}; want {low} to {high - 1}")
    value &= (1 << 8 * size) - 1
    if not text:
        return value.to_bytes(size, "big")
    return b"%08X" % value if node == "p32" else b"%X" % value


# ---------------------------------------------------------------- reading


def decode(text: str, dialect: bytes, data: bytes) -> list[Any]:
    """The values of a host's arguments. Raises `Rejected` with the device's error code; never anything else."""
    reader: _Words | _Octets = _Words(data) if dialect == ASCII else _Octets(data)
    values = _values(layout(text), reader)
    if not reader.ended:
        raise Rejected(Code.TOO_MUCH)
    return values


def _values(nodes: tuple[Node, ...], reader: _Words | _Octets) -> list[Any]:
    values: list[Any] = []
    for node in nodes:
        if isinstance(node, tuple):
            values.append([_values(node, reader) for _ in range(reader.number("u16"))])
        elif node in INTEGERS:
            values.append(reader.number(node))
        elif node == "f32":
            (value,) = struct.unpack(">f", reader.number("u32").to_bytes(4, "big"))
            if not math.isfinite(value):
                raise Rejected(Code.INVALID_DATA)
            values.append(value)
        elif node == "*":
            values.append(reader.rest())
        elif node in ARRAYS:
            values.append(reader.array(node, reader.number("u16")))
        else:
            values.append(reader.text(reader.number("u16") if node == "str" else int(node[1:])))
    return values


class _Octets:
    """Arguments in CoLa-B."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def ended(self) -> bool:
        return self._at == len(self._data)

    def _take(self, size: int) -> bytes:
        self._at += size
        if self._at > len(self._data):
            raise Rejected(Code.TOO_LITTLE)
        return self._data[self._at - size : self._at]

    def number(self, node: str) -> int:
        return int.from_bytes(self._take(INTEGERS[node]), "big", signed=node[0] != "u")

    def text(self, size: int) -> str:
        raw = self._take(size)
        if STX in raw or ETX in raw:  # CoLa-A could not tell it to anybody
            raise Rejected(Code.INVALID_CHARACTER)
        return raw.decode("latin-1")

    def array(self, node: str, count: int) -> NDArray[Any]:
        return np.frombuffer(self._take(count * INTEGERS[node[:-1]]), ARRAYS[node])

    def rest(self) -> bytes:
        return self._take(len(self._data) - self._at)


class _Words:
    """Arguments in CoLa-A: a text of known length may hold blanks."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data.strip(b" "), 0

    @property
    def ended(self) -> bool:
        return self._at >= len(self._data)

    def _go_on(self, at: int) -> None:
        while at < len(self._data) and self._data[at] == BLANK:
            at += 1
        self._at = at

    def number(self, node: str) -> int:
        if self.ended:
            raise Rejected(Code.TOO_LITTLE)
        end = self._data.find(b" ", self._at)
        end = end if end >= 0 else len(self._data)
        word = self._data[self._at : end]
        self._go_on(end)
        bits = 8 * INTEGERS[node]
        signed = node[0] != "u"
        if DECIMAL.fullmatch(word):
            value = int(word)
        elif HEX.fullmatch(word):
            value = int(word, 16)
            if signed and 1 << bits - 1 <= value < 1 << bits:
                value -= 1 << bits
        else:
            raise Rejected(Code.INVALID_CHARACTER)
        low, high = (-(1 << bits - 1), 1 << bits - 1) if signed else (0, 1 << bits)
        if not low <= value < high:
            raise Rejected(Code.VALUE_OVERFLOW)
        return value

    def text(self, size: int) -> str:
        raw = self._data[self._at : self._at + size]
        if len(raw) < size:
            raise Rejected(Code.TOO_LITTLE)
        if self._data[self._at + size : self._at + size + 1] not in (b"", b" "):
            raise Rejected(Code.INVALID_DATA)
        self._go_on(self._at + size)
        return raw.decode("latin-1")

    def array(self, node: str, count: int) -> NDArray[Any]:
        return np.array([self.number(node[:-1]) for _ in range(count)], ARRAYS[node])

    def rest(self) -> bytes:
        raw, self._at = self._data[self._at :].replace(b" ", b""), len(self._data)
        if len(raw) % 2 or (raw and not re.fullmatch(rb"[0-9A-Fa-f]+", raw)):
            raise Rejected(Code.INVALID_CHARACTER)
        return bytes.fromhex(raw.decode())


# ---------------------------------------------------------------- passwords


def short_hash(password: str) -> int:
    """The 32 bits of `SetAccessMode`: the words of the MD5 XORed, bytes in reverse order. `client` is F4724744."""
    digest = hashlib.md5(password.encode("latin-1"), usedforsecurity=False).digest()
    words = [int.from_bytes(digest[k : k + 4], "little") for k in range(0, 16, 4)]
    return words[0] ^ words[1] ^ words[2] ^ words[3]
