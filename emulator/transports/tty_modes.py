"""Terminal settings read and written without the C library's list of speeds: any baud rate, on Linux.

`termios` knows speeds by code only; a host that asks for 123 457 baud (BOTHER) is seen through `struct termios2`, which
the master of a pseudo-terminal may read too.
"""

from __future__ import annotations

import array
import fcntl
import struct
import termios
from dataclasses import dataclass

TCGETS2 = 0x802C542A
"linux/asm-generic/ioctls.h: _IOR('T', 0x2A, struct termios2); x86, ARM, RISC-V."
TERMIOS2 = struct.Struct("=4I20s2I")
"c_iflag, c_oflag, c_cflag, c_lflag; c_line and c_cc; c_ispeed, c_ospeed."


LINES_CHARACTER = 18
"Of the 19 control characters the one that nothing uses: the preload shim leaves word of the modem lines there."
LINES_KNOWN, LINE_DTR, LINE_RTS = 0x80, 1, 2


@dataclass(frozen=True)
class TtyModes:
    """The settings of a terminal that a line's other end would notice."""

    receives_baud: int
    "0: hung up (B0)."
    sends_baud: int
    ignore_break: bool
    ignore_errors: bool
    zero_errors: bool


def read_modes(fd: int) -> TtyModes:
    """Settings of the terminal `fd`, or of the slave when `fd` is a pseudo-terminal's master."""
    try:
        iflag, _, _, _, _, receives, sends = TERMIOS2.unpack(fcntl.ioctl(fd, TCGETS2, bytes(TERMIOS2.size)))
    except OSError:  # an architecture with another layout
        iflag, _, _, _, in_code, out_code, _ = termios.tcgetattr(fd)
        receives, sends = _baud_of(in_code), _baud_of(out_code)
    return TtyModes(
        receives_baud=receives or sends,
        sends_baud=sends,
        ignore_break=bool(iflag & (termios.IGNBRK | termios.BRKINT)),
        ignore_errors=bool(iflag & termios.IGNPAR),
        zero_errors=bool(iflag & termios.INPCK),
    )


def read_lines(fd: int) -> tuple[bool, bool] | None:
    """DTR and RTS as the preload shim has left word of them at the terminal `fd`; None: it has not."""
    try:
        word = TERMIOS2.unpack(fcntl.ioctl(fd, TCGETS2, bytes(TERMIOS2.size)))[4][1 + LINES_CHARACTER]
    except OSError:  # an architecture with another layout, for which there is no shim
        return None
    return (bool(word & LINE_DTR), bool(word & LINE_RTS)) if word & LINES_KNOWN else None


def forget_lines(fd: int) -> None:
    """Take that word away from the terminal `fd`."""
    modes = termios.tcgetattr(fd)
    modes[6][LINES_CHARACTER] = b"\0"
    termios.tcsetattr(fd, termios.TCSANOW, modes)


def _baud_of(code: int) -> int:
    codes = {getattr(termios, name): int(name[1:]) for name in dir(termios) if name[:1] == "B" and name[1:].isdigit()}
    return codes.get(code, code)


def set_raw(fd: int, code: int = termios.B9600) -> None:
    """Eight bits, nothing interpreted, no echo, at the speed of that `termios` code."""
    control = termios.tcgetattr(fd)[6]
    control[termios.VMIN], control[termios.VTIME] = 1, 0
    cflag = code | termios.CS8 | termios.CREAD | termios.CLOCAL
    termios.tcsetattr(fd, termios.TCSANOW, [0, 0, cflag, 0, code, code, control])


def waiting_input(fd: int) -> int:
    """Bytes that could be read from `fd` now."""
    return _int_ioctl(fd, termios.FIONREAD)


def waiting_output(fd: int) -> int:
    """Bytes written to the terminal `fd` that its driver has not sent yet."""
    return _int_ioctl(fd, termios.TIOCOUTQ)


def _int_ioctl(fd: int, request: int) -> int:
    number = array.array("i", [0])
    fcntl.ioctl(fd, request, number)
    return number[0]
