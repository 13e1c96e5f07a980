"""The test matrix of process failures: expected effect on the wire, counters, incidents and exit code.

Belongs here: the table, as data. Tests run its rows (`held_by`), docs/process_faults.md shows them
(`python -m emulator.endurance.process_faults`), and the real-time soak draws from those that can be drawn.
"""

from __future__ import annotations

import signal
from collections.abc import Iterator
from dataclasses import dataclass

PLAYED = "tests/measuring/test_supervision.py"
SYSTEM = "tests/system/test_process_faults.py"
SHARING = "tests/measuring/test_sharing.py"
RIG_VIRTUAL = "tests/measuring/test_process_faults.py"


@dataclass(frozen=True)
class Drawn:
    """How the soak does it to a running daemon."""

    number: signal.Signals
    for_s: float = 0.0
    "SIGCONT follows after so long; 0: never."


@dataclass(frozen=True)
class ProcessFault:
    """One row."""

    on: str
    "worker | sender | view | recorder | host"
    do: str
    "kill | stop | slow | out of memory | full pipe | cannot start | full disk"
    when: str
    clock: str
    "real | virtual | both"
    wire: str
    counted: str
    exit_code: str
    held_by: str
    "File and name of the test that does it."
    incidents: tuple[str, ...] = ()
    "Kinds that are noted, in order; those in brackets only where it lasts."
    drawn: Drawn | None = None

    @property
    def name(self) -> str:
        """In one line."""
        return f"{self.on}: {self.do}, {self.when} ({self.clock} time)"


REPLACED = ("worker replaced", "(sensor silent)", "(sensor back)")
PAUSE = "its sensors pause while a new worker builds the scene, then continue at their rate; others are not affected"
LATE = "`measured too late`: every scan of the pause"
NOTHING = "`measured too late`: what becomes late until then, mostly nothing"
ZERO = "0; 5 if the pause is longer than a sensor may be silent"

PROCESS_FAULTS = (
    ProcessFault("worker", "kill", "at start", "both", "nothing: no link is opened",
                 "an error message with signal and moment",
                 "2", f"{PLAYED}::test_a_first_start_that_fails_says_why"),
    ProcessFault("worker", "kill", "between sweeps", "real", PAUSE, LATE, ZERO,
                 f"{PLAYED}::test_a_killed_worker_costs_some_scans", REPLACED, Drawn(signal.SIGKILL)),
    ProcessFault("worker", "kill", "during a sweep", "real", PAUSE, LATE, ZERO,
                 f"{PLAYED}::test_a_killed_worker_costs_some_scans", REPLACED),
    ProcessFault("worker", "kill", "while another worker is free", "real", "the other measures its sweeps", NOTHING,
                 "0", f"{SYSTEM}::test_killed_and_stopped_workers", ("worker replaced",)),
    ProcessFault("worker", "stop", "while another worker is free", "real",
                 "the other measures its sweeps, the one in hand too after 0.1 s", NOTHING,
                 "0", f"{SHARING}::test_a_process_that_is_lost_costs_no_scan_while_another_is_free",
                 ("worker replaced",)),
    ProcessFault("worker", "kill", "while it sends a scan", "real", PAUSE, LATE, ZERO,
                 f"{PLAYED}::test_a_killed_worker_costs_some_scans", REPLACED),
    ProcessFault("worker", "kill", "repeatedly, by a sweep", "real",
                 "the sensors whose sweeps end it pause, up to 30 s; others continue", LATE, "5",
                 f"{PLAYED}::test_one_sensor_that_ends_its_worker_with_every_sweep_does_not_stop_the_others",
                 ("worker replaced", "sensor silent", "(sensor back)")),
    ProcessFault("worker", "kill", "repeatedly, between sweeps", "real",
                 "pauses between attempts double up to 30 s", LATE, "5",
                 f"{PLAYED}::test_a_crash_loop_between_sweeps_is_slowed_down",
                 ("worker replaced", "sensor silent", "(worker lost)", "(worker back)", "(sensor back)")),
    ProcessFault("worker", "kill", "during a sweep", "virtual", "the same bytes as without", "nothing is lost", "0",
                 f"{RIG_VIRTUAL}::test_a_worker_that_is_killed_or_stopped_changes_no_byte_of_virtual_time",
                 ("worker replaced",)),
    ProcessFault("worker", "stop", "for less than 5 s", "real",
                 "its sensors pause, then continue; no outdated scan is sent", LATE, ZERO,
                 f"{PLAYED}::test_a_worker_that_goes_on_in_time_is_kept_and_what_it_owed_is_not_sent",
                 ("(sensor silent)", "(sensor back)"), Drawn(signal.SIGSTOP, 1.0)),
    ProcessFault("worker", "stop", "permanently, during a sweep", "real",
                 "as killed, once a sweep has taken 5 s and twenty times the longest of the last sixteen", LATE, "5",
                 f"{PLAYED}::test_a_hung_worker_is_replaced_after_the_stated_time",
                 ("sensor silent", "worker replaced", "sensor back"), Drawn(signal.SIGSTOP)),
    ProcessFault("worker", "stop", "permanently, while a new worker builds the scene", "real",
                 "as killed, once it has used no CPU time for 60 s", LATE, "5",
                 f"{PLAYED}::test_a_successor_that_is_stopped_while_it_builds_is_replaced",
                 ("worker replaced", "sensor silent", "worker replaced", "sensor back")),
    ProcessFault("worker", "stop", "at start", "both", "nothing: no link is opened",
                 "an error message, after 60 s without CPU time", "2",
                 f"{PLAYED}::test_a_first_start_that_fails_says_why"),
    ProcessFault("worker", "stop", "during a sweep", "virtual",
                 "the same bytes as without: time stops until it is replaced", "nothing is lost", "0",
                 f"{RIG_VIRTUAL}::test_a_worker_that_is_killed_or_stopped_changes_no_byte_of_virtual_time",
                 ("worker replaced",)),
    ProcessFault("worker", "stop", "at the end of a run", "both", "nothing", "it is killed after half a second", "0",
                 f"{PLAYED}::test_the_end_of_a_run_does_not_wait_for_a_stopped_worker"),
    ProcessFault("worker", "slow", "each sweep takes three scan times", "real", "a third of the scans, each the newest",
                 "`measured too late`: the others", "0",
                 f"{PLAYED}::test_a_slow_worker_sends_the_newest_and_counts_the_others"),
    ProcessFault("worker", "slow", "the first sweep takes a minute", "real", "nothing until it is measured",
                 LATE, "5", f"{PLAYED}::test_a_first_sweep_may_take_long_while_it_uses_the_processor",
                 ("sensor silent", "(sensor back)")),
    ProcessFault("worker", "out of memory", "MemoryError in a sweep", "both", "a scan without echoes",
                 "`failures` by cause; reported once", "0",
                 f"{PLAYED}::test_a_sweep_out_of_memory_comes_back_without_echoes", ("sweep unmeasured",)),
    ProcessFault("worker", "out of memory", "killed by the kernel", "real", PAUSE, LATE, ZERO,
                 f"{PLAYED}::test_a_killed_worker_costs_some_scans", REPLACED),
    ProcessFault("worker", "full pipe", "stopped, a plan larger than the pipe", "real",
                 "other sensors continue", LATE, ZERO,
                 f"{PLAYED}::test_a_full_pipe_does_not_block_the_sender", ("(sensor silent)", "(sensor back)")),
    ProcessFault("worker", "cannot start", "fork refused", "real", "its sensors are silent, others continue", LATE, "5",
                 f"{PLAYED}::test_a_worker_that_cannot_be_started_is_tried_again_and_the_others_go_on",
                 ("worker replaced", "worker lost", "sensor silent", "(worker back)", "(sensor back)")),
    ProcessFault("worker", "cannot start", "a mesh file is missing", "real",
                 "its sensors are silent, others continue", LATE, "5",
                 f"{PLAYED}::test_a_mesh_that_has_gone_is_told_and_tried_again",
                 ("worker replaced", "worker lost", "sensor silent", "(worker back)", "(sensor back)")),
    ProcessFault("worker", "cannot start", "five times in a row", "virtual", "the run ends",
                 "an error message with the reason",
                 "2 of `test`, 5 of `run`", f"{RIG_VIRTUAL}::test_virtual_time_does_not_stand_for_ever_for_a_worker",
                 ("worker replaced", "worker lost")),
    ProcessFault("sender", "stop", "for 2 s", "real", "all sensors pause, then continue at their rate; no burst",
                 LATE, "0", f"{SYSTEM}::test_a_stopped_sender_and_stopped_onlookers"),
    ProcessFault("sender", "kill", "any", "real", "every link ends; the next start takes over their paths",
                 "no process is left: workers end with it", "-9",
                 f"{SYSTEM}::test_a_killed_sender_leaves_nobody_behind"),
    ProcessFault("view", "stop", "while it shows a run", "real", "nothing", "nothing", "0",
                 f"{SYSTEM}::test_a_stopped_sender_and_stopped_onlookers"),
    ProcessFault("view", "kill", "while it shows a run", "real", "nothing", "nothing", "0",
                 f"{SYSTEM}::test_a_stopped_sender_and_stopped_onlookers"),
    ProcessFault("recorder", "full disk", "any", "both", "nothing: the run continues",
                 "reported once; the recording ends before the run", "4",
                 f"{RIG_VIRTUAL}::test_a_full_disk_ends_the_recording_and_not_the_run", ("recording ended",)),
    ProcessFault("host", "stop", "while it reads", "real",
                 "data that it does not read is lost, as on a line; others continue",
                 "`bytes_lost` or `payloads_dropped` of its link", "0",
                 f"{SYSTEM}::test_a_stopped_sender_and_stopped_onlookers"),
    ProcessFault("host", "kill", "while it reads", "real",
                 "the device continues to stream (a line), or has no client (a socket)",
                 "`bytes_lost` of its link", "0", f"{SYSTEM}::test_a_stopped_sender_and_stopped_onlookers"),
)  # fmt: skip
"Every row; docs/process_faults.md is written from it."


def drawn() -> tuple[ProcessFault, ...]:
    """Those that the soak draws from."""
    return tuple(row for row in PROCESS_FAULTS if row.drawn is not None)


def table() -> Iterator[str]:
    """The rows as lines of a Markdown table."""
    yield "| process | failure | when | time | on the wire | counters | incidents | exit code |"
    yield "|---|---|---|---|---|---|---|---|"
    for row in PROCESS_FAULTS:
        kinds = ", ".join(row.incidents) or "-"
        cells = (row.on, row.do, row.when, row.clock, row.wire, row.counted, kinds, row.exit_code)
        yield "| " + " | ".join(cells) + " |"


def main() -> int:
    """Print the table."""
    from emulator.output.lines import say

    for line in table():
        say(line)
    return 0


if __name__ == "__main__":
    main()
