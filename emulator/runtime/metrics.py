"""A run's counters and its lateness as Prometheus text (exposition format 0.0.4)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from emulator.instrument.instrument import Instrument
from emulator.process.incidents import Incidents
from emulator.runtime.liveness import Liveness


def prometheus(
    instruments: Sequence[Instrument], incidents: Incidents | None = None, liveness: Liveness | None = None
) -> str:
    """Counters and the histogram of every sensor, incidents of the run, and who is silent."""
    silence = [] if liveness is None else _silence_lines(instruments, liveness)
    return "\n".join([*_lines(instruments), *_incident_lines(incidents or Incidents()), *silence]) + "\n"


def _silence_lines(instruments: Sequence[Instrument], liveness: Liveness) -> Iterator[str]:
    yield "# HELP lidaremu_sensor_silent_seconds Time since the last scan while a host waits for scans."
    yield "# TYPE lidaremu_sensor_silent_seconds gauge"
    for one in instruments:
        yield f'lidaremu_sensor_silent_seconds{{sensor="{_label(one.sensor)}"}} {liveness.silent_s(one.sensor):g}'


def _incident_lines(incidents: Incidents) -> Iterator[str]:
    yield "# HELP lidaremu_incidents_total Incidents of processes, files and links, by kind."
    yield "# TYPE lidaremu_incidents_total counter"
    for (kind, where), count in sorted(dict(incidents.counts).items()):
        yield f'lidaremu_incidents_total{{kind="{_label(kind)}",on="{_label(where)}"}} {count}'


def _label(text: str) -> str:
    return text.replace("\\", r"\\").replace('"', r"\"").replace("\n", r"\n")


def _by_reason(what: str, meaning: str, dropped: Iterable[tuple[str, Mapping[str, int]]]) -> Iterator[str]:
    yield f"# HELP lidaremu_{what}_dropped_total {meaning}, by reason."
    yield f"# TYPE lidaremu_{what}_dropped_total counter"
    for sensor, counts in dropped:
        for reason, count in sorted(counts.items()):
            labels = f'sensor="{_label(sensor)}",reason="{_label(reason)}"'
            yield f"lidaremu_{what}_dropped_total{{{labels}}} {count}"


def _lines(instruments: Sequence[Instrument]) -> Iterator[str]:
    yield "# HELP lidaremu_scans_sent_total Scans handed to the links."
    yield "# TYPE lidaremu_scans_sent_total counter"
    for one in instruments:
        yield f'lidaremu_scans_sent_total{{sensor="{_label(one.sensor)}"}} {one.stats.scans_sent}'
    yield "# HELP lidaremu_scans_account Scans requested by hosts, by state; unaccounted must be 0."
    yield "# TYPE lidaremu_scans_account gauge"
    for one in instruments:
        account = one.ledger.account()
        for state in ("asked", "sent", "withdrawn", "under_way", "unaccounted"):
            yield f'lidaremu_scans_account{{sensor="{_label(one.sensor)}",state="{state}"}} {account[state]}'
    yield from _by_reason("scans", "Scans dropped", [(one.sensor, one.stats.scans_dropped) for one in instruments])
    yield from _by_reason("input", "Input dropped", [(one.sensor, one.stats.input_dropped) for one in instruments])
    yield "# HELP lidaremu_fault_hits_total Hits of faults, by name."
    yield "# TYPE lidaremu_fault_hits_total counter"
    for one in instruments:
        for name, row in () if one.faults is None else one.faults.counts().items():
            yield f'lidaremu_fault_hits_total{{sensor="{_label(one.sensor)}",fault="{_label(name)}"}} {row["hits"]}'
    yield "# HELP lidaremu_link_bytes_total Bytes by direction; lost: not read by any host."
    yield "# TYPE lidaremu_link_bytes_total counter"
    for one in instruments:
        for index, link in enumerate(one.links):
            counts = {"in": link.stats.bytes_in, "out": link.stats.bytes_out, "lost": link.stats.bytes_lost}
            for direction, count in counts.items():
                labels = f'sensor="{_label(one.sensor)}",link="{index}",direction="{direction}"'
                yield f"lidaremu_link_bytes_total{{{labels}}} {count}"
    yield "# HELP lidaremu_lateness_seconds Actual minus scheduled time of each send."
    yield "# TYPE lidaremu_lateness_seconds histogram"
    for one in instruments:
        label, total = _label(one.sensor), 0
        for edge_us, count in one.stats.lateness.histogram():
            total += count
            edge = f"{edge_us * 1e-6:g}" if edge_us else "+Inf"
            yield f'lidaremu_lateness_seconds_bucket{{sensor="{label}",le="{edge}"}} {total}'
        yield f'lidaremu_lateness_seconds_sum{{sensor="{label}"}} {one.stats.lateness.sum_ns * 1e-9:.9f}'
        yield f'lidaremu_lateness_seconds_count{{sensor="{label}"}} {total}'
