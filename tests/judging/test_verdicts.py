"""Trials of sensors that die, and of those that do not; what a failed expectation tells; virtual time, no hardware."""

from __future__ import annotations

import json
import xml.etree.ElementTree as Tree
from pathlib import Path

import pytest

from emulator.commands.cli import main
from emulator.instrument.summary import summary
from emulator.judging.expectations import Judgement, Judgements
from emulator.judging.trial import Trial, Verdict
from emulator.run_report.gather import gather
from emulator.run_report.page import report_of
from emulator.scenario import scenario

SCENE = """\
schema: 1
duration_s: 3
world: [{plane: {size_m: [20, 20]}, at_m: [5, 0, 0], pitch_deg: 90, material: asphalt}]
weather: {changes: [{t_s: 0.5, fog: {visibility_m: 500}}]}
sensors: [{id: front, model: %s, device: %s}]
faults: [%s]
expect:
  - {that: front.scans_per_s, within: [%s]}
  - {that: max(front.gap_s), at_most: 0.3}
  - {that: front.gap_s < 0.3}
  - {that: front.silent_s, equals: 0}
  - {that: front.restarts, equals: 1}
  - {that: max(front.gap_s), at_most: 0.3, to_s: 0.9, name: before it}
"""
LMS = "sick-lms291-s05", "{resolution_deg: 1.0, field_deg: 100}"


def tried(tmp_path: Path, fault: str, rate: str = "74, 76", sensor: tuple[str, str] = LMS, **keys: object) -> Verdict:
    path = tmp_path / "case.yaml"
    path.write_text(SCENE % (*sensor, fault, rate), encoding="utf-8")
    trial = Trial(scenario.load(str(path), [f"{key}={value}" for key, value in keys.items()]))
    try:
        return trial.finish()
    finally:
        trial.close()


def by_name(verdict: Verdict) -> dict[str, Judgement]:
    return {item.name: item for item in verdict.judgements}


@pytest.mark.parametrize(
    "fault",
    ["do: hang", "do: power_cycle, off_s: 1", "do: power_cycle, off_s: 60", "do: reboot", "do: unplug"],
)
def test_a_sensor_that_dies_fails_its_test_and_the_verdict_says_when_and_why(tmp_path: Path, fault: str) -> None:
    name = fault.split()[1].rstrip(",")
    verdict = tried(tmp_path, f"{{at_s: 1.0, on: front, {fault}}}")
    found = by_name(verdict)
    for expected in ("front.scans_per_s", "max(front.gap_s)", "front.gap_s < 0.3", "front.silent_s"):
        judged = found[expected]
        assert not judged.held, judged
        assert judged.at_s == pytest.approx(0.9867, abs=1e-3)
        assert judged.until_s == pytest.approx(3.0)
        assert any(name in text for text in judged.active), judged
    assert found["front.silent_s"].value == pytest.approx(2.0133, abs=1e-3)
    assert found["max(front.gap_s)"].value == pytest.approx(2.0133, abs=1e-3)
    assert found["before it"].held
    assert "weather changed at 0.5 s (fog)" in found["max(front.gap_s)"].active
    (warning,) = (text for text in verdict.warnings if "silent" in text)
    assert warning.startswith("front: silent at the end, no scan for 2.013 s of 3 s")
    assert name in warning
    assert verdict.sensors[0]["silent_s"] == pytest.approx(2.0133, abs=1e-3)
    assert verdict.sensors[0]["scans_per_s"] < 20.0


@pytest.mark.parametrize(
    ("sensor", "rate", "duration_s"), [(LMS, "74, 76", 4), (("sick-ld-oem1000", "{}"), "9, 11", 12)]
)
def test_a_healthy_run_has_the_gaps_of_its_scans_alone(
    tmp_path: Path, sensor: tuple[str, str], rate: str, duration_s: int
) -> None:
    verdict = tried(tmp_path, "", rate, sensor, duration_s=duration_s)
    found = by_name(verdict)
    assert all(item.held for item in found.values() if item.name != "before it"), found  # an LD has not begun by then
    assert not verdict.warnings
    assert verdict.sensors[0]["silent_s"] == 0.0


@pytest.mark.parametrize("end", [b"\x20\x25", b"\x20\x25 late"])
def test_a_stream_that_its_host_has_stopped_is_no_silence(tmp_path: Path, end: bytes) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(SCENE % (*LMS, "", "74, 76"), encoding="utf-8")
    from protocols.lms2xx.telegrams import request

    trial = Trial(scenario.load(str(path)))
    trial.run.advance(1_000_000_000 if b"late" not in end else 2_900_000_000)
    host = trial.run.hosts[0]
    host._line.write(request(end[:2]), trial.run.clock.now_ns())
    host.step = lambda now_ns: None  # type: ignore[method-assign]
    verdict = trial.finish()
    trial.close()
    found = by_name(verdict)
    assert found["front.silent_s"].held, found["front.silent_s"]
    assert found["front.scans_per_s"].held
    assert not verdict.warnings


def test_a_fault_that_ends_in_time_is_a_gap_and_no_silence(tmp_path: Path) -> None:
    verdict = tried(tmp_path, "{at_s: 1.0, on: front, do: hang, for_s: 0.5}")
    found = by_name(verdict)
    assert found["front.silent_s"].held
    gap = found["max(front.gap_s)"]
    assert gap.value == pytest.approx(0.506, abs=0.02)
    assert gap.at_s == pytest.approx(0.987, abs=1e-3)
    assert "fault hang from 1.000 s to 1.500 s" in gap.active
    assert not verdict.warnings


def test_nothing_is_owed_before_the_first_scan_was_asked_for(tmp_path: Path) -> None:
    verdict = tried(tmp_path, "{at_s: 0, on: front, do: hang}")
    found = by_name(verdict)
    assert found["front.silent_s"].held
    assert not found["front.scans_per_s"].held  # there is no rate


def test_judgements_are_false_with_a_readable_text_when_one_fails() -> None:
    held = Judgement("a", True, "1", "1")
    failed = Judgement("b", False, "2", "1", value=2.0, at_s=1.5, sensor="front", active=("fault hang from 1.000 s",))
    assert Judgements([held])
    assert not Judgements([held, failed])
    with pytest.raises(
        AssertionError, match=r"failed: 1 of 2 expectations\n  b: 2; expected 1; at 1\.500 s: 2; active"
    ):
        Judgements([held, failed]).check()
    Judgements([held]).check()


def test_text_json_junit_and_report_tell_the_silence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "case.yaml"
    fault = "{at_s: 1.0, on: front, do: hang}"
    path.write_text(SCENE % (*LMS, fault, "1, 76"), encoding="utf-8")
    junit, record = tmp_path / "junit.xml", tmp_path / "recorded"
    assert main(["test", str(path), "--junitxml", str(junit), "--record", str(record)]) == 1
    out = capsys.readouterr().out
    assert "failed: 3 of 6 expectations" in out
    assert "warning: front: silent at the end" in out
    assert "active then: fault hang from 1.000 s" in out
    root = Tree.parse(junit).getroot()
    assert "silent at the end" in (root.findtext(".//system-err") or "")
    assert any("at 0.987 s to 3.000 s" in one.get("message", "") for one in root.iter("failure"))
    assert main(["test", str(path), "--json"]) == 1
    row = json.loads(capsys.readouterr().out)
    assert any("silent at the end" in text for text in row["warnings"])
    assert row["sensors"][0]["silent_s"] > 2.0
    (failed,) = [one for one in row["expect"] if one["name"] == "front.silent_s"]
    assert failed["sensor"] == "front"
    assert failed["at_s"] == pytest.approx(0.987, abs=1e-3)

    run = gather(record / "case", with_truth=False)
    made = report_of(run)
    assert any(text.startswith("Warning: front: silent at the end") for text in made.summary)
    chapter = next(one for one in made.sections if one.title == "Expectations")
    assert chapter.text[0] == "failed: 3 of 6 expectations."
    assert len(chapter.pictures) == 3
    assert run.sensors["front"].rate_hz < 20.0


def test_the_summary_of_a_live_sensor_counts_its_silence(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text(SCENE % (*LMS, "{at_s: 1.0, on: front, do: hang}", "74, 76"), encoding="utf-8")
    trial = Trial(scenario.load(str(path)))
    trial.run.advance(900_000_000)
    assert summary(trial.instruments[0])["silent_s"] == 0.0
    trial.run.advance(2_000_000_000)
    assert summary(trial.instruments[0])["silent_s"] == pytest.approx(1.0, abs=0.03)
    trial.close()
