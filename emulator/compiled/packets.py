"""Rays on Embree in packets: sixteen neighbouring rays at once cost a third of what they cost one by one.

Belongs here: the library that embreex brings, by its public functions; structures for packets; the search. Not: which
rays are searched where (raycast, moving_cast).

embreex itself offers single rays. The library keeps a packet together where the processor has so wide registers, and
falls back to single rays where it has not.
"""

from __future__ import annotations

import ctypes
import importlib.util
import weakref
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from emulator.compiled.jit import EMBREE, OUT_SINGLES, OUT_WORDS, SINGLE_ROWS, compiled

Singles = NDArray[np.float32]

# Embree 4, rtcore_*.h
_MAJOR_VERSION = 1
_ROBUST = 1 << 2
_COHERENT = 1 << 16
_ALL_FEATURES = 0xFFFFFFFF
_TRIANGLES, _INDEX, _VERTEX = 0, 0, 1
_THREE_UINTS, _THREE_FLOATS = 0x5003, 0x9003
_NATIVE_PACKETS = {16: 34, 8: 33, 4: 32}
"Properties of a device: packets of so many rays stay together."
_FIELDS = 24
"Numbers a ray: 12 of RTCRay, 8 or 9 of RTCHit, and some room."


class _Arguments(ctypes.Structure):
    """How to search: the first members of RTCIntersectArguments, and room for later ones."""

    _fields_ = (
        ("flags", ctypes.c_uint32),
        ("features", ctypes.c_uint32),
        ("context", ctypes.c_void_p),
        ("filter", ctypes.c_void_p),
        ("intersect", ctypes.c_void_p),
        ("room", ctypes.c_uint64 * 4),
    )


class _Library:
    """Embree as embreex brings it."""

    def __init__(self, path: Path) -> None:
        here = ctypes.CDLL(str(path))
        pointer, number = ctypes.c_void_p, ctypes.c_int
        for name, result, arguments in (
            ("rtcNewDevice", pointer, (ctypes.c_char_p,)),
            ("rtcGetDeviceProperty", ctypes.c_ssize_t, (pointer, number)),
            ("rtcGetDeviceError", number, (pointer,)),
            ("rtcNewScene", pointer, (pointer,)),
            ("rtcSetSceneFlags", None, (pointer, number)),
            ("rtcCommitScene", None, (pointer,)),
            ("rtcReleaseScene", None, (pointer,)),
            ("rtcNewGeometry", pointer, (pointer, number)),
            ("rtcSetNewGeometryBuffer", pointer, (pointer, number, ctypes.c_uint, number, *2 * (ctypes.c_size_t,))),
            ("rtcCommitGeometry", None, (pointer,)),
            ("rtcAttachGeometry", ctypes.c_uint, (pointer, pointer)),
            ("rtcReleaseGeometry", None, (pointer,)),
        ):
            function = getattr(here, name)
            function.restype, function.argtypes = result, arguments
        self.call = here
        self.device = here.rtcNewDevice(None)
        if here.rtcGetDeviceProperty(self.device, _MAJOR_VERSION) != 4:
            raise OSError(f"{path}: not Embree 4")
        native = (size for size, number in _NATIVE_PACKETS.items() if here.rtcGetDeviceProperty(self.device, number))
        self.width = next(native, 4)
        self.function = ctypes.cast(getattr(here, f"rtcIntersect{self.width}"), pointer).value
        self.arguments = _Arguments(_COHERENT, _ALL_FEATURES)


@cache
def library() -> _Library | None:
    """The library; None where embreex has no such file."""
    spec = importlib.util.find_spec("embreex")
    if spec is None or spec.origin is None:
        return None
    home = Path(spec.origin).parent
    places = (home.parent / "embreex.libs", home / ".dylibs", home)
    files = [path for place in places for path in sorted(place.glob("*embree4*")) if not path.suffix == ".py"]
    for path in files:
        try:
            return _Library(path)
        except (OSError, AttributeError):
            continue
    return None


class Packets:
    """Triangles in a search structure, for packets."""

    def __init__(self, vertices: Singles, faces: NDArray[np.int32]) -> None:
        """`vertices` : (v, 3), `faces` : (f, 3). Raises MemoryError where they do not fit."""
        embree = library()
        assert embree is not None
        call, device = embree.call, embree.device
        scene = call.rtcNewScene(device)
        weakref.finalize(self, call.rtcReleaseScene, scene)
        call.rtcSetSceneFlags(scene, _ROBUST)
        geometry = call.rtcNewGeometry(device, _TRIANGLES)
        for kind, form, values in ((_VERTEX, _THREE_FLOATS, vertices), (_INDEX, _THREE_UINTS, faces)):
            into = call.rtcSetNewGeometryBuffer(geometry, kind, 0, form, 12, len(values))
            if not into:
                raise MemoryError(f"embree: no room for {len(values)} {'vertices' if kind else 'triangles'}")
            ctypes.memmove(into, np.ascontiguousarray(values).ctypes.data, 12 * len(values))
        call.rtcCommitGeometry(geometry)
        call.rtcAttachGeometry(scene, geometry)
        call.rtcReleaseGeometry(geometry)
        call.rtcCommitScene(scene)
        if call.rtcGetDeviceError(device):
            raise MemoryError("embree: structure not built")
        self.how = (embree.function, embree.width, scene, ctypes.addressof(embree.arguments))
        "What a search needs: function, rays a packet, scene, arguments."

    def run(self, origin: Singles, ray: Singles, until: Singles) -> tuple[NDArray[np.int32], Singles]:
        """Triangle (-1: none) and distance of the first hit of each ray (m, 3); as `embree.run`."""
        triangle = np.full(len(until), -1, np.int32)
        _search(*self.how, origin, ray, until, triangle)
        return triangle, until


@intrinsic  # type: ignore[untyped-decorator]
def call_embree(typing: Any, function: Any, valid: Any, scene: Any, rays: Any, arguments: Any) -> Any:
    """void function(const int* valid, RTCScene, RTCRayHitN*, RTCIntersectArguments*), all given as addresses."""
    signature = types.void(*5 * (types.int64,))

    def code(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), 4 * [pointer])
        target = builder.inttoptr(values[0], kind.as_pointer())
        builder.call(target, [builder.inttoptr(value, pointer) for value in values[1:]])
        return context.get_dummy_value()

    return signature, code


DIRECTION, TFAR, MASK, TRIANGLE, GEOMETRY = 4, 8, 9, 17, 18
"Rows of a packet; a ray's origin is in the first three. A packet is (`_FIELDS`, width) numbers."


@compiled()
def room(width):  # type: ignore[no-untyped-def]
    """A packet, from a multiple of 64 bytes on; the same as whole numbers; which of its lanes are valid."""
    numbers = np.zeros(_FIELDS * width + 16, np.float32)
    first = (64 - numbers.ctypes.data % 64) % 64 // 4
    packet = numbers[first : first + _FIELDS * width].reshape(_FIELDS, width)
    flags = packet.view(np.int32)
    flags[MASK, :] = -1
    lanes = np.zeros(width + 16, np.int32)
    first = (64 - lanes.ctypes.data % 64) % 64 // 4
    return packet, flags, lanes[first : first + width]


@compiled()
def put(packet, flags, lanes, lane, ox, oy, oz, dx, dy, dz, until):  # type: ignore[no-untyped-def]
    """One ray into its lane; one with a number that is not finite meets nothing."""
    packet[0, lane], packet[1, lane], packet[2, lane] = ox, oy, oz
    packet[DIRECTION, lane], packet[DIRECTION + 1, lane], packet[DIRECTION + 2, lane] = dx, dy, dz
    packet[TFAR, lane] = until
    flags[TRIANGLE, lane] = flags[GEOMETRY, lane] = -1
    total = packet[0, lane] + packet[1, lane] + packet[2, lane]  # in float32, in which they may not be finite
    total += packet[DIRECTION, lane] + packet[DIRECTION + 1, lane] + packet[DIRECTION + 2, lane]
    lanes[lane] = -1 if total - total == np.float32(0.0) else 0


@compiled()
def put_all(packet, flags, lanes, which, used, origin, ray, centre, until):  # type: ignore[no-untyped-def]
    """The same with rays `which` of (3, m); a coordinate at a time, which is faster."""
    for i in range(3):
        to, direction, starts, ways, middle = packet[i], packet[DIRECTION + i], origin[i], ray[i], centre[i]
        for lane in range(used):
            to[lane] = starts[which[lane]] - middle
        for lane in range(used):
            direction[lane] = ways[which[lane]]
    ends, triangle, geometry = packet[TFAR], flags[TRIANGLE], flags[GEOMETRY]
    for lane in range(used):
        ends[lane] = until
    for lane in range(used):
        triangle[lane] = -1
    for lane in range(used):
        geometry[lane] = -1
    x, y, z = packet[0], packet[1], packet[2]
    dx, dy, dz = packet[DIRECTION], packet[DIRECTION + 1], packet[DIRECTION + 2]
    for lane in range(used):
        total = x[lane] + y[lane] + z[lane] + dx[lane] + dy[lane] + dz[lane]
        lanes[lane] = -1 if total - total == np.float32(0.0) else 0


@compiled()
def send(function, scene, arguments, packet, lanes, used):  # type: ignore[no-untyped-def]
    """Search for the rays in the `used` first lanes."""
    for lane in range(used, len(lanes)):
        lanes[lane] = 0
    call_embree(function, lanes.ctypes.data, scene, packet.ctypes.data, arguments)


@compiled(*EMBREE, SINGLE_ROWS, SINGLE_ROWS, OUT_SINGLES, OUT_WORDS)
def _search(function, width, scene, arguments, origin, ray, until, triangle):  # type: ignore[no-untyped-def]
    packet, flags, lanes = room(width)
    for begin in range(0, len(until), width):
        used = min(width, len(until) - begin)
        for lane in range(used):
            k = begin + lane
            put(packet, flags, lanes, lane, origin[k, 0], origin[k, 1], origin[k, 2],
                ray[k, 0], ray[k, 1], ray[k, 2], until[k])  # fmt: skip
        send(function, scene, arguments, packet, lanes, used)
        for lane in range(used):
            if lanes[lane]:
                triangle[begin + lane] = flags[TRIANGLE, lane]
                until[begin + lane] = packet[TFAR, lane]
