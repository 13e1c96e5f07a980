"""What sessions of all families share, so that a family holds only its own facts: codec, commands, schedule, settings.

events      what happened, bounded
instants    rasters of numbered instants, timers, everything due by now at its own instant
outbox      what has not left, in the order in which it is due
wanted      the sweep asked for, and the epoch by which stale scans are refused
receiving   bytes in any chunking to requests and faults, inter-byte time-outs, one receiver a connection
keys        the scenario's `device:` table, key by key
session     a session of these parts, for families with a schedule of their own
sweeps      a device that measures one sweep after the other, and the hosts that want them
one_way     a device that only sends: datagrams over the sweep, and those that come by the clock
requests    a device with a table of commands
family      `FAMILY` of a session, its keys and its commands

`docs/family.md` builds two families of it. Belongs here: what two families need and no wire knows. Imports `protocols`
alone, and no family.
"""
