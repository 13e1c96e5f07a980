"""What sessions of all families have in common; a family adds its own facts: codec, commands, schedule, settings.

events      event log, bounded
instants    numbered instants, timers, alarms, execution of everything due at its own instant
outbox      telegrams not sent yet, in the order of their due times
wanted      the requested sweep, and the epoch by which outdated scans are refused
receiving   bytes in any chunking to requests and faults, inter-byte time-outs, one receiver per connection
keys        the scenario's `device:` table, key by key
session     a session of these parts, for families with a schedule of their own
sweeps      a device that measures one sweep after the other, and its subscribers
one_client  a device that serves one TCP client at a time
one_way     a device that only sends: datagrams of sweeps, and periodic ones
requests    a device with a command table
descriptors replies of such devices behind `A5 5A`, length and type
http        requests and replies of a web interface
cola_values values of CoLa in either dialect, by layout; error codes; what passwords become
cola_frames telegrams of CoLa in either dialect
nmea        sentences of a satellite receiver
utc         true time and its full seconds, for clocks that follow a receiver or a master
rotor       angle of a rotor that turns freely, and the turns that its samples make
ramping     angle of a head that ramps to a speed, piece by piece
turning     a device with such a rotor: sweeps are turns with as many samples as fall into them
family      `FAMILY` of a session, its keys and its commands; with a table of models or without

`docs/family.md` builds two families with it. Belongs here: what two families need, independent of the protocol. Imports
only `protocols`, and no family.
"""
