"""One sensor on its links: session, input, counters, observers, the series of its run.

Belongs here: what holds for one sensor whatever the clock. Not: all sensors of a run (runtime), faults (injection
keeps the contract of `fault_hooks`), files (recording).

May import: `objects` (metrics), `measuring`, `faults` (events), `hosts` (what a scan read is), `transports`,
`process` and below.
"""
