"""The keys that every fault has: on which sensor, what, when it begins, how long it lasts.

Belongs here: names and bounds. Not: the keys of single faults (the layers), whether they fit together (reading).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from emulator.config.tables import DescribedTable

Seconds = Annotated[float, Field(ge=0.0, le=1e9)]
Span = Annotated[float, Field(gt=0.0, le=1e9)]
Count = Annotated[int, Field(ge=1, le=10**12)]


class Common(DescribedTable):
    """An injected fault; its other keys depend on `do`, see `lidaremu list faults NAME`."""

    model_config = ConfigDict(extra="allow")

    on: str
    "The sensor."
    do: str
    "Name of the fault, see `lidaremu list faults`."
    at_s: Seconds | None = None
    "Begins then; with another trigger: that one counts from then on."
    at_telegram: Count | None = None
    "Begins with the n-th telegram, datagram or frame (of those that `of` and `label` name)."
    every: Count | None = None
    "Begins with each n-th of them."
    probability: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    "Begins with each of them by this chance; a fault of what is measured: holds in each sweep by this chance."
    on_command: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    "Begins when a host's command of this code or name has been taken: `20 24`, `GET_PROFILE`."
    when: Annotated[str, Field(min_length=1, max_length=2000)] | None = None
    "Begins when this expression over the last scan becomes true, as `front.nearest_on(car) < 10`."
    for_s: Span | None = None
    "Lasts so long, each time it begins."
    for_telegrams: Count | None = None
    "Lasts so many telegrams."
    count: Count | None = None
    "Is over for good after so many hits; of a fault that holds for a time: after it has begun so often."
    link: Annotated[int, Field(ge=0, le=63)] | None = None
    "Only that link of the sensor, by its number; None: all."
    direction: Literal["to_host", "from_host"] | None = None
    "Which way the bytes go; faults that exist both ways hit what goes to the host by themselves."
    of: Literal["all", "scans", "replies"] | None = None
    "Which telegrams it counts and hits; from_host: all that comes."
    label: Annotated[str, Field(min_length=1, max_length=60)] | None = None
    "Only telegrams of this name: `B0`, `ACK`; on CAN the name of the message in the DBC: `ObjGeneral`."


MOMENTS = ("at_telegram", "every", "probability", "on_command", "when")
"Triggers beside `at_s`; at most one."
TRIGGERS = ("at_s", *MOMENTS)
OF_TELEGRAMS = ("direction", "of", "label")
"Keys that have a meaning for faults of telegrams, bytes and frames alone, or for a trigger that counts them."
