"""What services 0601 to 0802 do: interface routing, files in flash, monitor; and REGISTER_APPLICATION.

Words of requests and replies: UPS (SICK 8011576), p. 18 and 35-43.
"""

from __future__ import annotations

from protocols.ld import files, routing
from protocols.ld.answers import Answer, Words, refuses
from protocols.ld.device import Device
from protocols.ld.routing import CAN, SERIAL, Attached
from protocols.ld.telegrams import REFUSED, words_text

DONE = 0


def _com_refuses(words: Words, detail: str) -> Answer:
    return refuses((words[0] if words else REFUSED, REFUSED), detail)


def attach(device: Device, words: Words, now_ns: int) -> Answer:
    """COM_ATTACH: neither the interface that asks, nor one that another host holds."""
    interface, caller = words[0], device.caller
    if interface not in (SERIAL, CAN) or caller is None or caller.interface == interface:
        return _com_refuses(words, f"interface {interface}")
    held = device.attached.get(interface)
    if held is not None and held.holder != caller.address:
        return _com_refuses(words, f"interface {interface} is held by another host")
    device.attached[interface] = held or Attached(caller.address, caller.route, device.baud)
    return Answer((interface, DONE))


def detach(device: Device, words: Words, now_ns: int) -> Answer:
    """COM_DETACH: the interface serves the protocol again, at its own speed."""
    held = _held(device, words)
    if held is None:
        return _com_refuses(words, "interface is not attached to this host")
    del device.attached[words[0]]
    changed = words[0] == SERIAL and held.baud != device.baud
    return Answer((words[0], DONE), line_speed=device.baud if changed else None)


def initialise(device: Device, words: Words, now_ns: int) -> Answer:
    """COM_INIT: speed of the serial line, filter of the CAN bus; the bus itself keeps the speed it has."""
    held = _held(device, words)
    if held is None:
        return _com_refuses(words, "interface is not attached to this host")
    if words[0] == CAN:
        filtered = routing.can_filter(words[1:])
        if filtered is None:
            return _com_refuses(words, "CAN settings")
        held.can_filter = filtered
        return Answer((CAN, DONE))
    baud = routing.serial_baud(words[1:])
    if baud is None:
        return _com_refuses(words, "serial settings")
    changed, held.baud = baud != held.baud, baud
    return Answer((SERIAL, DONE), line_speed=baud if changed else None)


def output(device: Device, words: Words, now_ns: int) -> Answer:
    """COM_OUTPUT: answered at once, while it leaves."""
    if _held(device, words) is None:
        return _com_refuses(words, "interface is not attached to this host")
    routed = (routing.serial_output if words[0] == SERIAL else routing.can_output)(words[1:])
    if routed is None:
        return _com_refuses(words, "no output, or one that is cut")
    return Answer((words[0], DONE), routed=tuple(routed))


def _held(device: Device, words: Words) -> Attached | None:
    held = device.attached.get(words[0]) if words else None
    return held if held is not None and device.caller is not None and held.holder == device.caller.address else None


# files


def directory(device: Device, words: Words, now_ns: int) -> Answer:
    """DIR."""
    return Answer((files.free_words(device.files), *sorted(device.files)))


def save(device: Device, words: Words, now_ns: int) -> Answer:
    """SAVE."""
    device.files, status = files.saved(device.files, words)
    number = words[0] if words else 0
    return Answer((number, status)) if status == files.SAVED else refuses((number, status), f"status {status}")


def load(device: Device, words: Words, now_ns: int) -> Answer:
    """LOAD."""
    number = words[0] if words else 0
    if number < files.FIRST_ID:
        return refuses((number, files.BAD_LOAD), f"file {number:04X}")
    if number not in device.files:
        return refuses((number, files.ABSENT), f"no file {number:04X}")
    return Answer((number, files.LOADED, *device.files[number]))


def delete(device: Device, words: Words, now_ns: int) -> Answer:
    """DELETE."""
    device.files, status = files.deleted(device.files, words)
    return Answer((status,)) if status == files.DELETED else refuses((status,), f"status {status}")


# monitor


def monitor(device: Device, words: Words, now_ns: int) -> Answer:
    """MONITOR_RUN: the first interface that switches it on has it until it switches it off."""
    if _watched_elsewhere(device):
        return refuses((REFUSED,), "another interface monitors")
    device.monitor = device.caller if words[0] else None
    return Answer((DONE,))


def monitor_profiles(device: Device, words: Words, now_ns: int) -> Answer:
    """MONITOR_PROFILE_LOG: whether the monitor gets a copy of every profile."""
    if _watched_elsewhere(device):
        return refuses((REFUSED,), "another interface monitors")
    device.monitors_profiles = bool(words[0])
    return Answer((DONE,))


def _watched_elsewhere(device: Device) -> bool:
    watcher, caller = device.monitor, device.caller
    return watcher is not None and caller is not None and watcher.address.link != caller.address.link


# application


def register(device: Device, words: Words, now_ns: int) -> Answer:
    """REGISTER_APPLICATION: part number, name and version, 12 characters each; items 0020 to 0022 from now on."""
    names = ("application_part_number", "application_name", "application_version")
    texts = [words_text(words[6 * place : 6 * place + 6]) for place in range(3)]
    known = [text for text in texts if text is not None]
    if len(words) < 18 or len(known) < 3:
        return refuses((REFUSED,), "want three texts of 12 ASCII characters")
    device.identity = {**device.identity, **dict(zip(names, known, strict=True))}
    return Answer((DONE,))
