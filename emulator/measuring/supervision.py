"""Worker processes, each serving a fixed share of the sensors; one that ends or hangs is replaced.

Belongs here: what each owes, when it is started, given up and started again. Not: what runs in it (worker), how long is
waited (time limit), what is informed of it (daemon, virtual_daemon).

Nothing here waits for a process: starting, building a scene and dying go on while hosts are served. The descriptors of
pipes are known to one epoll set of our own, which lets go of each before it is closed; whoever waits for workers waits
for that set, whose number stays the same however often a process is replaced.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Any

from emulator.errors import EmulatorError, SceneError
from emulator.measuring.conditions import NORMAL, Conditions
from emulator.measuring.homes import Blame, Handover, Home, Question, Successor, Sweep
from emulator.measuring.measuring import BuildMeasures, NotMeasured, Reported
from emulator.measuring.parts import PartOfScan
from emulator.measuring.sharing import Shared
from emulator.measuring.upgrade import Building, Upgrade
from emulator.measuring.worker import Forked, Handle, Pipe
from emulator.process import time_limits
from emulator.process.clock import Clock, SystemClock
from emulator.process.time_limits import RunningTime, Stillness
from emulator.scenario.weather import WeatherConfig
from protocols.scan import Scan, ScanPlan

READ, BOTH = select.EPOLLIN, select.EPOLLIN | select.EPOLLOUT
ENDING_NS = 2_000_000
"Until the exit code of a process whose pipe has closed is looked for again."
MOST_TRIES = 2
"A sweep that has ended its worker so often comes back without echoes."
VIRTUAL_FAILURES = 5
"Virtual time stands while a worker is missing: not for ever."
LOST_AFTER = 3
"Processes in a row that did not come to be ready; from then on it is reported that none can be started."
KILLED, OUT_OF_MEMORY = "SIGKILL", " (out of memory?)"
GRACE_S = 0.5
"For workers that have been asked to end; then they are made to."


class Workers:
    """All worker processes of a run. Must be made before any link is opened.

    A worker that ends, or stands still for longer than `patience` allows, is replaced by one that gets what it owed. A
    sweep that cannot be measured, or that ends its worker twice, is reported in `failures` and comes back without
    echoes: one sensor's fault stops no other. With a `run_clock` sweeps become late while no worker is there: they come
    back as `NotMeasured`, and their devices choose later ones.
    """

    def __init__(
        self,
        build: BuildMeasures,
        sensors: Sequence[str],
        count: int,
        run_clock: Clock | None = None,
        clock: Clock | None = None,
        launch: Callable[[bool | None], Handle] | None = None,
        build_loops: Callable[[], Building] | None = None,
        shared: Sequence[str] = (),
    ) -> None:
        """Waits until each has built its scene; `EmulatorError` says why one could not.

        `run_clock` reports the time of plans; None: it is virtual and stands while sweeps are owed. `clock`: by which
        processes are judged. `launch` starts one, with compiled loops or without; None: as this process is switched.
        `build_loops` begins to build what is not there yet: processes begin with arrays and go over to loops later.
        `shared`: sensors that remember nothing from sweep to sweep: several processes may measure one of them.
        """
        self._shared = Shared(shared)
        self._claimed: list[Sweep] = []
        "Measured ahead and asked for since: in virtual time they come when it stands, as all others."
        self._launch: Callable[[bool | None], Handle] = partial(Forked, build) if launch is None else launch
        self._clock = SystemClock() if clock is None else clock
        self._run_clock = run_clock
        self._ran = RunningTime()
        self._ran.pass_to(self._clock.now_ns())
        self._epoll = select.epoll()
        most = count if shared else min(count, len(sensors))
        shares = [list(sensors)[number :: max(1, count)] for number in range(max(1, most))]
        self._homes = [Home(number, share) for number, share in enumerate(shares)]
        self._home = {sensor: home for home in self._homes for sensor in home.sensors}
        self._dying: list[Handle] = []
        self._blame: dict[str, Blame] = {}
        self._done: dict[str, list[Scan]] = {}
        self._fresh: set[str] = set()
        self.failures: list[str] = []
        "What could not be measured, not yet reported; whoever does empties it."
        self.incidents: list[tuple[str, str, str]] = []
        "Incidents of the processes: kind, worker, text; likewise."
        self._reported = Reported()
        self.warnings: list[str] = []
        "What is not yet passed on; whoever does empties it."
        self.notes: list[str] = []
        "What is reported and is no fault; likewise."
        self._first = True
        self._upgrade: Upgrade | None = None
        self._as_switched = build_loops is None
        try:
            for home in self._homes:
                self._start(home)
            while any(home.state != "ready" for home in self._homes):
                self._epoll.poll(time_limits.TICK_NS * 1e-9)
                self.poll()
                self.check()
        except BaseException:
            self.close()
            raise
        self._first = False
        if build_loops is not None:
            self._upgrade = Upgrade(build_loops, self._launch, self._epoll, self.notes, self._ran.ns)

    # what others ask

    def filenos(self) -> tuple[int, ...]:
        """The descriptor that becomes readable when `poll` has something to do: the same for the whole run."""
        return (self._epoll.fileno(),)

    def request(self, sensor: str, plan: ScanPlan, conditions: Conditions = NORMAL) -> None:
        for work in self._shared.parts(Sweep(sensor, plan, conditions), self._homes):
            self._owe(work)

    def has_slices(self, sensor: str, plan: ScanPlan) -> bool:
        """Whether that sweep may be measured in slices of time."""
        return not self.in_virtual_time and self._shared.has_slices(sensor, plan, self._homes)

    def request_slice(self, sensor: str, plan: ScanPlan, conditions: Conditions, number: int, of: int) -> None:
        """Measure one slice of a sweep, see `parts`; the scan comes when all have been measured."""
        work = self._shared.slice_of(Sweep(sensor, plan, conditions), number, of)
        if work is not None:
            self._owe(work)

    def _owe(self, work: Sweep) -> None:
        home = self._home[work.sensor]
        home.owed.append(work)
        self._begin(home)
        if home.in_hand is work:
            return
        if work.sensor in self._shared.sensors:
            self._spread()
        else:
            self._queue(home)

    def _spread(self) -> None:
        """Processes that are free take what waits for others; what nobody begins at once waits in pipes."""
        for home in self._homes:
            self._begin(home)
        for home in self._homes:
            self._queue(home)

    @property
    def in_virtual_time(self) -> bool:
        """Sweeps may be measured long before they are asked for: virtual time stands while they are."""
        return self._run_clock is None

    def spare(self, sensor: str, behind: bool = True) -> int:
        """How many further sweeps of that sensor would be begun at once, or right behind one of its own."""
        return self._shared.spare(sensor, self._homes, behind)

    def request_ahead(self, sensor: str, plan: ScanPlan, conditions: Conditions) -> None:
        """Measure a sweep before it is asked for; it waits until it is claimed or dropped."""
        work = Sweep(sensor, plan, conditions, ahead=True)
        self._shared.begin(work)
        self._owe(work)

    def claim(self, sensor: str, early: ScanPlan, plan: ScanPlan) -> bool:
        """Ask for `plan`, the same sweep as `early`, which was measured ahead; False: that is not to be had."""
        work = self._shared.claimed(sensor, early, plan)
        if work is None:
            return False
        if work.scan is not None:
            self._claimed.append(work)
            if not self.in_virtual_time:
                self._deliver_claimed()
        return True

    def drop(self, sensor: str, plans: Sequence[ScanPlan]) -> None:
        """What was measured ahead for these plans is not asked for."""
        for work in self._shared.of_plans(sensor, plans):
            self._shared.forget(work)
            self._throw_away(work)

    def _throw_away(self, work: Sweep) -> None:
        for home in self._homes:
            if home.holds(work):
                work.given_up = True
            elif work in home.owed:
                home.owed.remove(work)

    def _deliver_claimed(self) -> None:
        claimed, self._claimed = self._claimed, []
        for work in claimed:
            assert work.scan is not None
            self._deliver(work, work.scan)

    def judge(self, weather: WeatherConfig) -> list[Future[dict[str, str]]]:
        questions = []
        for home in self._homes:
            questions.append(Question(home.sensors, weather))
            home.owed.append(questions[-1])
            self._hand_over(home)
        return [one.answer for one in questions]

    def collect(self, sensor: str) -> list[Scan]:
        return self._done.pop(sensor, [])

    @property
    def run_clock(self) -> Clock | None:
        """Reports the time of plans."""
        return self._run_clock

    def takes_ns(self, sensor: str) -> int | None:
        """The longest of the last sweeps of that sensor; None while the first one in its process is still to come."""
        if sensor not in self._home:
            return 0  # it measures nothing
        home = self._home[sensor]
        homes = self._homes if sensor in self._shared.sensors else [home]
        if home.state == "ready" and all(one.pace[sensor].fresh for one in homes):
            return None
        return max(one.pace[sensor].longest_ns for one in homes)

    def rows(self) -> list[dict[str, object]]:
        """The processes, for whoever asks."""
        return [
            {
                "worker": home.number,
                "pid": None if home.handle is None else home.handle.pid,
                "state": home.state,
                "form": home.form or None,
                "started": home.starts,
                "measured": home.measured,
                "sensors": list(home.sensors) or sorted(self._shared.sensors),
            }
            for home in self._homes
        ]

    def poll(self) -> set[str]:
        """Take in what workers have sent; the sensors that have fresh scans, or have to choose other ones."""
        self._ran.pass_to(self._clock.now_ns())
        for number, _ in self._epoll.poll(0):
            home = next((one for one in self._homes if one.fileno == number), None)
            if home is not None:
                self._attend(home)
            elif self._upgrade is not None and (warm := self._upgrade.attend(number, self._homes, self._ran.ns)):
                self._hand_over(warm)
        fresh, self._fresh = self._fresh, set()
        return fresh

    def check(self) -> set[str]:
        """Judge the processes: called about every `time_limits.TICK_NS`, and at `soon` sooner. Sensors as `poll`."""
        now_ns = self._ran.pass_to(self._clock.now_ns())
        self._dying = [one for one in self._dying if one.exit_code() is None]
        for home in self._homes:
            self._check(home, now_ns)
            if self._run_clock is not None:
                for again in self._shared.again(home, self._homes, now_ns):
                    self._owe(again)
                self._give_up_late(home, now_ns, self._run_clock.now_ns())
            self._begin(home)
        self._spread()
        if self._upgrade is not None and not self._upgrade.is_over:
            self._upgrade.check(self._homes, now_ns)
        fresh, self._fresh = self._fresh, set()
        return fresh

    @property
    def check_ns(self) -> int:
        """How long `check` can wait."""
        return ENDING_NS if any(home.state == "ending" for home in self._homes) else time_limits.TICK_NS

    def settle(self, go_on: Callable[[], bool] = lambda: True) -> set[str]:
        """Wait until nothing is owed, as long as `go_on`; the sensors that have fresh scans. Virtual time stands
        meanwhile. `EmulatorError` when no worker can be started any more."""
        fresh: set[str] = set()
        self._deliver_claimed()
        if any(home.in_hand is not None for home in self._homes):
            fresh |= self.poll()
        next_ns = self._clock.now_ns() + self.check_ns
        while any(work.is_awaited for home in self._homes for work in home.owed):
            self._epoll.poll(self.check_ns * 1e-9)
            fresh |= self.poll()
            if self._clock.now_ns() >= next_ns:
                fresh |= self.check()
                next_ns = self._clock.now_ns() + self.check_ns
                if not go_on():
                    break
            for home in self._homes:
                if home.failures >= VIRTUAL_FAILURES and home.state == "dead":
                    raise SceneError(f"{home.name}: {home.failures} processes in a row: the last {home.why}")
        fresh |= self._fresh
        self._fresh = set()
        return fresh

    def close(self) -> None:
        """End the workers; one that stands still is made to."""
        handles = [home.handle for home in self._homes if home.handle is not None]
        if self._upgrade is not None:
            self._dying += self._upgrade.close(self._homes)
        for home in self._homes:
            self._let_go(home)
            home.state = "dead"
        for handle in handles:
            handle.ask_to_end()
        clock = SystemClock()
        while any(one.exit_code() is None for one in handles) and clock.now_ns() < GRACE_S * 1e9:
            select.select([], [], [], 0.005)
        for handle in [one for one in (*handles, *self._dying) if one.exit_code() is None]:
            handle.kill()
        clock = SystemClock()
        while any(one.exit_code() is None for one in (*handles, *self._dying)) and clock.now_ns() < GRACE_S * 1e9:
            select.select([], [], [], 0.005)
        self._dying.clear()
        self._epoll.close()

    # a worker's life

    def _start(self, home: Home) -> None:
        if self._upgrade is not None and (successor := self._upgrade.taken(home)) is not None:
            self._install(home, successor)
            return
        home.starts += 1
        for pace in home.pace.values():
            pace.fresh = True
        try:
            home.handle = self._launch(self._with_loops)
        except OSError as error:
            text = f"cannot be started: {error.strerror or error}"
            if self._first:
                raise EmulatorError(f"the measuring process {text}") from None
            self._ended(home, text)
            return
        home.pipe = Pipe(home.handle.pipe)
        home.fileno = home.handle.pipe.fileno()
        home.state, home.since_ns = "starting", self._ran.ns
        home.stillness = Stillness(self._ran.ns)
        self._epoll.register(home.fileno, READ)

    @property
    def _with_loops(self) -> bool | None:
        """How a process is started now."""
        return None if self._as_switched else self._upgrade is not None and self._upgrade.loops

    def _install(self, home: Home, successor: Successor) -> None:
        """What served before is gone: this one serves, or will when it is ready."""
        home.starts += 1
        home.handle, home.pipe, home.fileno = successor.handle, successor.pipe, successor.fileno
        home.stillness, home.since_ns, home.form = Stillness(self._ran.ns), successor.since_ns, successor.form
        home.state, home.was_ready, home.ready_ns = "starting", False, self._ran.ns
        if successor.form:
            home.state, home.was_ready = "ready", True
        self._hand_over(home)

    def _replace(self, home: Home, state: object) -> None:
        """The successor goes on from what the process remembers, which is let go: nothing is in its hands."""
        successor = None if self._upgrade is None else self._upgrade.taken(home)
        if successor is None:
            return
        assert home.handle is not None
        self._let_go(home)
        home.handle.ask_to_end()
        self._dying.append(home.handle)
        successor.pipe.put((None, None, state))
        self._install(home, successor)

    def _attend(self, home: Home) -> None:
        """Its pipe has something to read, or room."""
        assert home.pipe is not None
        home.pipe.flush()
        try:
            for message in home.pipe.take():
                self._take(home, *message)
                if home.pipe is None:  # refused
                    return
        except EOFError:
            self._epoll.unregister(home.fileno)
            home.fileno = -1
            home.state, home.since_ns = "ending", self._ran.ns
            self._conclude(home)
            return
        self._mind_room(home)

    def _mind_room(self, home: Home) -> None:
        """Wait for room in its pipe only while something is to be written."""
        if home.pipe is not None and home.fileno >= 0:
            self._epoll.modify(home.fileno, BOTH if home.pipe.is_full else READ)

    def _take(self, home: Home, word: str, what: Any, result: Any) -> None:
        if word == "ready":
            home.form = what or ""
            self._ready(home, result)
        elif word == "refused":
            if self._first:
                raise what.of(result)
            self._ended(home, f"refused: {'; '.join(result)}")
        elif word == "warning":
            self.warnings += self._reported.new([result])
        elif home.in_hand is not None:
            self._finished(home, home.in_hand, word, result)

    def _ready(self, home: Home, warnings: Sequence[str]) -> None:
        took_s = (self._ran.ns - home.since_ns) * 1e-9
        home.state, home.since_ns, home.ready_ns, home.was_ready = "ready", self._ran.ns, self._ran.ns, True
        self.warnings += self._reported.new(warnings)
        if home.lost:
            home.lost = False
            self.incidents.append(("worker back", home.name, f"started again: the scene was built in {took_s:.1f} s"))
        self._hand_over(home)

    def _finished(self, home: Home, work: Sweep | Question, word: str, result: Any) -> None:
        home.owed.remove(work)
        took_ns = self._ran.ns - home.since_ns
        home.in_hand, home.behind = home.behind, None
        if home.in_hand is not None:  # it has begun when this one was done
            home.since_ns = self._ran.ns
            home.stillness = Stillness(home.since_ns)
        if isinstance(work, Handover):
            self._replace(home, result)
        elif isinstance(work, Question):
            work.answer.set_result(result)
        else:
            home.measured += 1
            home.latest[work.sensor] = self._shared.latest[work.sensor] = work
            home.pace[work.sensor].add(took_ns)
            self._blame.pop(work.sensor, None)
            if self._run_clock is None:
                home.failures = 0
            if word == "failed":
                if work.divided is None or not work.divided.is_over:
                    self.failures.append(f"{work.sensor}: sweep {work.plan.sweep}: {result}")
                result = Scan.empty(work.plan)
            elif isinstance(result, Scan):
                result = replace(result, plan=work.plan)
                if work.divided is not None:
                    self._shared.undivided(work.sensor)
            if not work.given_up:
                self._deliver(work, result)
        self._hand_over(home)

    def _deliver(self, work: Sweep, result: Scan | PartOfScan | None) -> None:
        """What has become of a sweep, or of a part of one."""
        if work.divided is not None:
            result = work.divided.take(work.part, result)
            if result is None:
                return
            for home in self._homes:  # it is settled: nothing more of it is measured
                for other in [one for one in home.owed if isinstance(one, Sweep) and one.divided is work.divided]:
                    if home.holds(other):
                        other.given_up = True
                    else:
                        home.owed.remove(other)
        assert isinstance(result, Scan)
        self._hand_on(work, result)

    def _hand_on(self, work: Sweep, scan: Scan) -> None:
        if work.ahead:
            if isinstance(scan, NotMeasured):
                self._shared.forget(work)
            else:
                work.scan = scan
            return
        work.scan = None
        if work.asked_as is not None:
            scan = replace(scan, plan=work.asked_as)
        self._done.setdefault(work.sensor, []).append(scan)
        self._fresh.add(work.sensor)

    def _hand_over(self, home: Home) -> None:
        """What its process begins now, and what waits in the pipe behind it."""
        self._begin(home)
        self._queue(home)

    def _begin(self, home: Home) -> None:
        if home.state != "ready" or home.in_hand is not None or home.pipe is None:
            return
        work = self._shared.next_of(home, self._homes, self._pauses)
        if work is None:
            return
        if isinstance(work, Sweep) and self._run_clock is not None:
            trial = self._shared.warms_up(home, work, self._homes)
            if trial is not None:
                home.owed.append(trial)
                work = trial
        home.in_hand = work
        home.since_ns = self._ran.pass_to(self._clock.now_ns())
        home.stillness = Stillness(home.since_ns)
        self._put(home, work)

    def _queue(self, home: Home) -> None:
        """One more into the pipe, so that the process goes on while the sender has other things to do."""
        if home.state != "ready" or home.behind is not None or home.pipe is None or home.pipe.is_full:
            return
        home.behind = self._shared.next_behind(home, self._homes, self._pauses)
        if home.behind is not None:
            self._put(home, home.behind)

    def _put(self, home: Home, work: Sweep | Question) -> None:
        assert home.pipe is not None
        home.pipe.put(work.as_sent())
        if home.pipe.is_full:
            self._mind_room(home)

    def _pauses(self, sensor: str) -> bool:
        return bool(self._blame) and sensor in self._blame and self._blame[sensor].until_ns > self._ran.ns

    # judging

    def _check(self, home: Home, now_ns: int) -> None:
        if home.state == "ending":
            self._conclude(home)
        elif home.state == "dead":
            if now_ns >= home.retry_ns:
                self._start(home)
        elif home.state == "starting":
            self._look(home, "building the scene", time_limits.BUILD_NS, time_limits.IDLE_BUILD_NS, now_ns)
        elif isinstance(home.in_hand, Question):
            doing = "handing over" if isinstance(home.in_hand, Handover) else "judging weather"
            self._look(home, doing, time_limits.QUESTION_NS, None, now_ns)
        elif home.state == "ready" and home.in_hand is not None:
            pace = home.pace[home.in_hand.sensor]
            what = f"measuring {home.in_hand.sensor}, sweep {home.in_hand.plan.sweep}"
            self._look(home, what, pace.deadline_ns, time_limits.IDLE_NS if pace.fresh else None, now_ns)

    def _look(self, home: Home, what: str, deadline_ns: int, idle_ns: int | None, now_ns: int) -> None:
        """Give a process up that has been at it for too long, or without using the processor."""
        assert home.handle is not None
        took_ns = now_ns - home.since_ns
        if took_ns > deadline_ns:
            self._ended(home, f"hung: {took_ns * 1e-9:.1f} s {what}; limit {deadline_ns * 1e-9:.1f} s")
        elif idle_ns is not None and took_ns > time_limits.TICK_NS:
            still_ns = home.stillness.look(now_ns, home.handle.cpu_ns())
            if still_ns > idle_ns:
                allowed = f"may rest {idle_ns * 1e-9:.0f} s"
                self._ended(home, f"hung: {still_ns * 1e-9:.1f} s without processor time {what}; {allowed}")

    def _conclude(self, home: Home) -> None:
        """Its pipe has closed: say how it ended, as soon as that is known."""
        assert home.handle is not None
        code = home.handle.exit_code()
        if code is not None or self._ran.ns - home.since_ns >= time_limits.TICK_NS:
            self._ended(home, _how_it_ended(code))

    def _ended(self, home: Home, why: str) -> None:
        """It is gone, or has to go: a new one is started, at once or after a pause."""
        was_ready, work = home.was_ready, home.in_hand
        if home.behind is not None and home.behind.given_up:
            home.owed.remove(home.behind)
        home.behind = None  # it had not begun: whoever comes next gets it
        self._let_go(home)
        if home.handle is not None:
            home.handle.kill()
            self._dying.append(home.handle)
        home.state, home.handle, home.in_hand, home.was_ready, home.form = "dead", None, None, False, ""
        if not was_ready and not why.startswith(("refused", "cannot")):
            why += " while it built the scene"
        if self._first:
            raise SceneError(f"the measuring process {why}{OUT_OF_MEMORY if KILLED in why else ''}")
        if isinstance(work, Sweep) and not why.startswith("hung"):
            why += f" while it measured {work.sensor}, sweep {work.plan.sweep}"
        elif was_ready and work is None:
            why += " between two sweeps"
        self._take_back(home, work)
        # a sensor that ends one worker after the other pauses itself: its worker need not
        blamed = isinstance(work, Sweep) and work.sensor in self._blame and self._blame[work.sensor].deaths > 1
        lived = was_ready and (blamed or self._ran.ns - home.ready_ns > time_limits.LIVED_NS)
        home.failures = 1 if lived else home.failures + 1
        pause_ns = time_limits.pause_ns(home.failures)
        home.why, home.retry_ns = why, self._ran.ns + pause_ns
        then = "at once" if not pause_ns else f"in {pause_ns * 1e-9:g} s"
        if home.failures < LOST_AFTER or was_ready:
            self.incidents.append(("worker replaced", home.name, f"{why}; a new one is started {then}"))
        elif not home.lost:
            home.lost = True
            tried = f"tried again {then}, then at least every {time_limits.LONGEST_PAUSE_NS * 1e-9:.0f} s"
            self.incidents.append(("worker lost", home.name, f"{why}: {home.failures} times in a row; {tried}"))
        if not pause_ns:
            self._start(home)
        self._spread()

    def _take_back(self, home: Home, work: Sweep | Question | None) -> None:
        """What was in the hands of a process that is gone."""
        if isinstance(work, Question):
            home.owed.remove(work)
            work.answer.set_result({})
        elif work is not None:
            work.tries += 1
            if self._run_clock is not None:
                blame = self._blame.setdefault(work.sensor, Blame())
                blame.deaths += 1
                blame.until_ns = self._ran.ns + time_limits.pause_ns(blame.deaths)
            if work.given_up:
                home.owed.remove(work)
            elif work.tries >= MOST_TRIES:
                home.owed.remove(work)
                self.failures.append(f"{work.sensor}: sweep {work.plan.sweep}: terminated its measuring process twice")
                self._deliver(work, Scan.empty(work.plan))

    def _let_go(self, home: Home) -> None:
        """Its pipe is known to nobody before its number is free for another."""
        if home.fileno >= 0:
            self._epoll.unregister(home.fileno)
            home.fileno = -1
        if home.pipe is not None:
            home.pipe.close()
            home.pipe = None

    def _give_up_late(self, home: Home, ran_ns: int, run_ns: int) -> None:
        """Sweeps that nobody measures while they become late go back: nothing is measured for the bin, nothing stale
        is sent, and when a worker is there again the newest come first."""
        held = home.state != "ready" or self._is_stalled(home, ran_ns)
        if not held and not self._blame:
            return
        for work in list(home.owed):
            if isinstance(work, Question) or work.given_up or work.end_ns >= run_ns or work not in home.owed:
                continue
            if not held and (home.holds(work) or not self._pauses(work.sensor)):
                continue
            if home.holds(work):
                work.given_up = True  # what comes of it is thrown away
            else:
                home.owed.remove(work)
            self._deliver(work, NotMeasured.empty(work.plan))

    def _is_stalled(self, home: Home, ran_ns: int) -> bool:
        if home.in_hand is None:
            return False
        work = home.in_hand
        allowed_ns = time_limits.STALLED_NS if isinstance(work, Question) else home.pace[work.sensor].stalled_ns
        return ran_ns - home.since_ns > allowed_ns


def _how_it_ended(code: int | None) -> str:
    if code is None:
        return "closed its pipe"
    if code >= 0:
        return f"ended with exit code {code}"
    with contextlib.suppress(ValueError):
        return f"ended with signal {-code} ({signal.Signals(-code).name})"
    return f"ended with signal {-code}"


def worker_count(useful: int) -> int:
    """Of as many as are of use; one core is left to the sender."""
    return max(1, min(useful, len(os.sched_getaffinity(0)) - 1))
