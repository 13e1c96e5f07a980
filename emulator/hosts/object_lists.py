"""Object lists read from CAN frames as a host reads them: ARS408, LD-MRS, ESR, Leddar; layouts from the DBC files.

Belongs here: frames in, lists out; which format a bus speaks. Not: buses (can_lines), conversations (can_objects).
A list that is not whole (frames lost, or another list begun) is counted and shown as far as it came.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from emulator.hosts.can_lines import Frame
from emulator.hosts.scans import HostObject, HostObjects
from protocols.can_objects.ars408_lists import CLASS_CODES, PROBABILITIES
from protocols.can_objects.layout import load
from protocols.can_objects.ldmrs_lists import CLASS_CODES as LDMRS_CODES
from protocols.can_objects.ldmrs_lists import VELOCITY_NOT_VALID

Values = Mapping[str, float]

ARS408_CLASSES = {code: name for name, code in reversed(CLASS_CODES.items())} | {0: "point"}
LDMRS_CLASSES = {code: name for name, code in reversed(LDMRS_CODES.items())}
EXISTENCE = (None, *PROBABILITIES, 1.0)
"Upper bound of each ProbExist code; 0 is invalid."
ESR_TRACKS = 64
VU8_FIELD_RAD, VU8_SEGMENTS = math.radians(48.0), 8
M16_FIELD_RAD, M16_SEGMENTS = math.radians(45.0), 16
"Of the modules with lenses of 48 and 45 degrees; detections tell segments, not angles."


class ListReader(ABC):
    """One format's lists, put together frame by frame."""

    model: ClassVar[str]
    file: ClassVar[str]

    def __init__(self) -> None:
        self._layout = load(self.file)
        self._count = 0
        self.errors = 0
        self.detail = ""

    @abstractmethod
    def feed(self, frame: Frame) -> HostObjects | None:
        """Take one frame of the bus; the list that it completes."""

    def keep_alive(self) -> list[Frame]:
        """Frames that the device wants ten times per second, so that it goes on."""
        return []

    def hello(self, more: bool) -> list[Frame]:
        """Frames to be sent at the beginning; `more`: ask for all that the device can tell."""
        return []

    def goodbye(self) -> list[Frame]:
        """Frames that undo `hello`."""
        return []

    def _decode(self, name: str, data: bytes) -> Values:
        return self._layout.decode(name, data)

    def _list(self, objects: Iterable[HostObject]) -> HostObjects:
        found = HostObjects(self._count, tuple(objects), self.detail)
        self._count += 1
        return found


class Ars408Reader(ListReader):
    """Objects of 0x60A to 0x60D, or clusters of 0x600 to 0x702, of the sensor with that id (0 to 7)."""

    model, file = "can-ars408", "ars408.dbc"
    WANTED: ClassVar[tuple[str, ...]] = (
        "ObjListHeader",
        "ObjGeneral",
        "ObjQuality",
        "ObjExtended",
        "ClusterListHeader",
        "ClusterGeneral",
        "SensorState",
    )
    _found: dict[int, dict[str, float]]

    def __init__(self, sensor_id: int = 0) -> None:
        super().__init__()
        self._shift = 0x10 * sensor_id
        self._names = {self._layout.identifier(name) + self._shift: name for name in self.WANTED}
        self._found = {}
        self._wanted = -1

    def feed(self, frame: Frame) -> HostObjects | None:
        name = self._names.get(frame.identifier)
        if name is None:
            return None
        values = self._decode(name, frame.data)
        if name in ("ObjListHeader", "ClusterListHeader"):
            whole = self._finish()
            self._wanted = int(values["NumObjects"] if name[0] == "O" else values["NumNear"] + values["NumFar"])
            self._found = {}
            return whole
        if name == "SensorState":
            faults = [key for key in ("ErrPersistent", "ErrTemporary", "ErrTemperature", "ErrVoltage") if values[key]]
            self.detail = ", ".join(key.removeprefix("Err").lower() + " fault" for key in faults)
        elif self._wanted >= 0:
            key = int(values["ClusterId" if name == "ClusterGeneral" else "ObjId"])
            self._found.setdefault(key, {}).update(values)
        return None

    def _finish(self) -> HostObjects | None:
        if self._wanted < 0:
            return None
        rows = {key: row for key, row in self._found.items() if "DistLong" in row}
        if len(rows) != self._wanted or len(rows) != len(self._found):
            self.errors += 1
        return self._list(self._object(key, row) for key, row in rows.items())

    def _object(self, number: int, row: Values) -> HostObject:
        extended = "ObjClass" in row
        return HostObject(
            number, row["DistLong"], row["DistLat"], row["VrelLong"], row["VrelLat"],
            row["Length"] if extended else None,
            row["Width"] if extended else None,
            math.radians(row["Orientation"]) if extended else None,
            ARS408_CLASSES.get(int(row["ObjClass"]), "?") if extended else ("cluster" if "ClusterId" in row else None),
            EXISTENCE[int(row["ProbExist"])] if "ProbExist" in row else None,
        )  # fmt: skip

    def hello(self, more: bool) -> list[Frame]:
        return [self._configure()] if more else []

    def _configure(self) -> Frame:
        flags = {"Set_SendQuality": 1, "Set_SendExtended": 1, "SendQuality": 1, "SendExtended": 1}
        return Frame(self._layout.identifier("SensorConfig") + self._shift, self._layout["SensorConfig"].frame(flags))


class LdmrsReader(ListReader):
    """Sixteen identifiers from `base`: header, two track frames, class and box of each object, trailer."""

    model, file = "can-ldmrs", "ldmrs.dbc"
    WANTED: ClassVar[tuple[str, ...]] = (
        "ListHeader", "ObjTrack1", "ObjTrack2", "ObjClassBox1", "ObjBox2", "ListTrailer", "ErrorsWarnings",
    )  # fmt: skip

    def __init__(self, base: int = 0x500) -> None:
        super().__init__()
        first = self._layout.identifier("ListHeader")
        self._names = {self._layout.identifier(name) - first + base: name for name in self.WANTED}
        self._found: dict[int, dict[str, float]] | None = None
        self._header: Values = {}

    def feed(self, frame: Frame) -> HostObjects | None:
        name = self._names.get(frame.identifier)
        if name is None:
            return None
        values = self._decode(name, frame.data)
        if name == "ErrorsWarnings":
            self.detail = "errors" if values["ErrorReg1"] or values["ErrorReg2"] else ""
        elif name == "ListHeader":
            self.errors += self._found is not None
            self._header, self._found = values, {}
        elif name == "ListTrailer" and self._found is not None:
            found, self._found = self._found, None
            rows = {key: row for key, row in found.items() if "PosX" in row}
            if len(rows) != int(self._header["NumObjects"]) or len(rows) != len(found):
                self.errors += 1
            return self._list(self._object(key, row) for key, row in rows.items())
        elif self._found is not None and "ObjId" in values:
            self._found.setdefault(int(values["ObjId"]), {}).update(values)
        return None

    def _object(self, number: int, row: Values) -> HostObject:
        not_valid = VELOCITY_NOT_VALID * 0.1 + 0.05
        speeds = [None if row[key] < not_valid else row[key] for key in ("VelX", "VelY")]
        reported = row.get("Reserved2", 0) > 0  # class and certainty in bytes that the manual reserves
        return HostObject(
            number, row["PosX"], row["PosY"], speeds[0], speeds[1],
            row.get("BoxSizeX"), row.get("BoxSizeY"), math.radians(row["BoxYaw"]) if "BoxYaw" in row else None,
            LDMRS_CLASSES.get(int(row["Reserved1"]), "?") if reported else None,
            row["Reserved2"] / 100.0 if reported else None,
        )  # fmt: skip


class EsrReader(ListReader):
    """Tracks of 0x500 to 0x53F. The radar radiates only while a host says so and reports its own motion."""

    model, file = "can-esr", "esr.dbc"

    def __init__(self, radiate: bool = True) -> None:
        super().__init__()
        self._first = self._layout.identifier("Track_01")
        self._status = {self._layout.identifier(name): name for name in ("Status1", "Status2")}
        self._found: dict[int, Values] | None = None
        "None before the first cycle that is heard from its beginning."
        self._radiate = radiate

    def feed(self, frame: Frame) -> HostObjects | None:
        status = self._status.get(frame.identifier)
        if status == "Status2":
            values = self._decode(status, frame.data)
            self.detail = "radiates" if values["TransceiverOn"] else "does not radiate"
        elif status == "Status1":
            self.errors += bool(self._found)
            self._found = {}
        slot = frame.identifier - self._first
        if self._found is not None and 0 <= slot < ESR_TRACKS:
            self._found[slot] = self._decode("Track_01", frame.data)  # all 64 have one layout
            if slot == ESR_TRACKS - 1:
                found, self._found = self._found, {}
                self.errors += len(found) != ESR_TRACKS
                return self._list(self._object(key + 1, row) for key, row in found.items() if row["Status"])
        return None

    def _object(self, number: int, row: Values) -> HostObject:
        azimuth = -math.radians(row["Angle"])  # clockwise positive on the wire
        across = row["LatRate"]
        along = (row["RangeRate"] - across * math.sin(azimuth)) / math.cos(azimuth)
        x, y = row["Range"] * math.cos(azimuth), row["Range"] * math.sin(azimuth)
        return HostObject(number, x, y, along, across, None, row["Width"] or None)

    def keep_alive(self) -> list[Frame]:
        if not self._radiate:
            return []
        motion = self._layout["EgoMotion1"].frame({"YawRateValid": 1})
        order = self._layout["SensorCommand"].frame({"Radiate": 1, "MaximumTracks": ESR_TRACKS - 1, "SpeedValid": 1})
        return [
            Frame(self._layout.identifier("EgoMotion1"), motion),
            Frame(self._layout.identifier("SensorCommand"), order),
        ]


class Vu8Reader(ListReader):
    """Detections of 0x752 (and up), opened by 0x751, after a request for the stream."""

    model, file = "can-leddar-vu8", "leddar_vu8.dbc"
    STREAM, STOP = 3, 1

    def __init__(self) -> None:
        super().__init__()
        self._head = self._layout.identifier("DetectionCount")
        self._first = self._layout.identifier("Detection")
        self._wanted: int | None = None
        self._found: list[HostObject] = []

    def feed(self, frame: Frame) -> HostObjects | None:
        if frame.identifier == self._head:
            self.errors += self._wanted is not None
            self._wanted, self._found = int(self._decode("DetectionCount", frame.data)["NumDetections"]), []
        elif self._wanted is not None and self._first <= frame.identifier < self._first + 96:
            self._found.append(self._object(len(self._found), self._decode("Detection", frame.data)))
        if self._wanted is None or len(self._found) < self._wanted:
            return None
        self._wanted = None
        return self._list(self._found)

    def _object(self, number: int, row: Values) -> HostObject:
        azimuth = VU8_FIELD_RAD * (0.5 - (row["Segment"] + 0.5) / VU8_SEGMENTS)
        return HostObject(number, row["Distance"] * math.cos(azimuth), row["Distance"] * math.sin(azimuth))

    def hello(self, more: bool) -> list[Frame]:
        return [self._request(self.STREAM)]

    def goodbye(self) -> list[Frame]:
        return [self._request(self.STOP)]

    def _request(self, function: int) -> Frame:
        return Frame(self._layout.identifier("Request"), self._layout["Request"].frame({"Function": function}))


class M16Reader(ListReader):
    """Detections of 0x750, two in a frame, opened by 0x751, after a request for the stream in that mode."""

    model, file = "can-leddar-m16", "leddar_m16.dbc"
    STREAM, STOP, ANSWERS = 5, 3, 128

    def __init__(self) -> None:
        super().__init__()
        self._head = self._layout.identifier("DetectionCount")
        self._of_list = {self._layout.identifier("Detections"), *range(self._head + 1, self._head + 97)}
        self._wanted: int | None = None
        self._found: list[HostObject] = []

    def feed(self, frame: Frame) -> HostObjects | None:
        if frame.identifier == self._head:
            count = int(self._decode("DetectionCount", frame.data)["NumDetections"])
            if count >= self.ANSWERS:
                return None
            self.errors += self._wanted is not None
            self._wanted, self._found = count, []
        elif self._wanted is not None and frame.identifier in self._of_list:
            row = self._decode("Detections", frame.data)
            for half in "12"[: self._wanted - len(self._found)]:
                self._found.append(self._object(row[f"Segment{half}"], row[f"Distance{half}"]))
        if self._wanted is None or len(self._found) < self._wanted:
            return None
        self._wanted = None
        return self._list(self._found)

    def _object(self, segment: float, distance_m: float) -> HostObject:
        azimuth = M16_FIELD_RAD * (0.5 - (segment + 0.5) / M16_SEGMENTS)
        return HostObject(len(self._found), distance_m * math.cos(azimuth), distance_m * math.sin(azimuth))

    def hello(self, more: bool) -> list[Frame]:
        return [self._request(self.STREAM)]

    def goodbye(self) -> list[Frame]:
        return [self._request(self.STOP)]

    def _request(self, function: int) -> Frame:
        return Frame(self._layout.identifier("Request"), self._layout["Request"].frame({"Function": function}))


READERS: Mapping[str, type[ListReader]] = {
    one.model: one for one in (Ars408Reader, LdmrsReader, EsrReader, Vu8Reader, M16Reader)
}
"Model, as in `list sensors` -> its reader."


def recognised(identifiers: Iterable[int]) -> ListReader | None:
    """The reader for a bus on which these identifiers were heard; None while they do not tell.

    An ARS408 by the header of its lists, which reports its sensor id; an ESR by its status; a Vu8 by its counts; an M16
    by counts with detections on the identifier before; an LD-MRS by header, time, and trailer eight further, wherever
    its base is.
    """
    heard = set(identifiers)
    for sensor_id in range(8):
        if {0x60A + 0x10 * sensor_id, 0x600 + 0x10 * sensor_id} & heard:
            return Ars408Reader(sensor_id)
    if 0x4E0 in heard and 0x500 in heard:
        return EsrReader(radiate=0x4F1 not in heard)  # its own vehicle may be talking to it
    if 0x751 in heard:  # on 0x750 a Vu8 only answers; identifiers that count up look like those of an LD-MRS
        return M16Reader() if 0x750 in heard and 0x752 not in heard else Vu8Reader()
    for base in sorted(heard):
        if {base + 1, base + 8} <= heard and base <= 0x7F0:
            return LdmrsReader(base)
    return None


def reader_of(model: str, **settings: Any) -> ListReader:
    """The reader of a model by name or a part of it, `can-ars408` or `ars408`; KeyError with the known names."""
    found = [name for name in READERS if model in name] if model not in READERS else [model]
    if len(found) != 1:
        raise KeyError(f"{model!r}; want one of {', '.join(READERS)}")
    return READERS[found[0]](**settings)
