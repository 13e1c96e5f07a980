"""Built-in hosts: interactive ones, and scripted ones for virtual time.

Belongs here: the other end of the wire, as an author who knows only the manual would write it. Not: pictures of what is
read (looking).

May import: `process`, `transports`, `protocols`.
"""
