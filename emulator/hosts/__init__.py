"""Built-in hosts: interactive ones, and scripted ones for virtual time.

Belongs here: the other end of the wire, as a stranger would write it. Not: pictures of what they read (looking).

May import: `process`, `transports`, `protocols`.
"""
