"""How long bytes take on a serial line, and until when it is busy."""

from __future__ import annotations

from protocols.skeleton.serial_lines import SerialLines, line_ns


def test_a_byte_has_ten_bits_and_instants_are_rounded_up() -> None:
    assert line_ns(1, 9600) == 1_041_667
    assert line_ns(0, 9600) == 0
    assert line_ns(1000, 1_000_000) == 10_000_000


def test_a_line_is_busy_until_everything_has_left() -> None:
    lines = SerialLines()
    assert lines.takes("one", 1000, 100, 1_000_000)
    assert lines.is_free("two", 1000)
    assert not lines.takes("one", 1_000_999, 1, 1_000_000)
    assert lines.is_free("one", 1_001_000), "a refused telegram occupies nothing"
    lines.occupy("one", 0, 50, 1_000_000)
    assert not lines.is_free("one", 1_500_999), "it follows what was sent before"
    assert lines.takes("one", 1_501_000, 1, 1_000_000)
