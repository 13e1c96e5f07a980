"""Hosts of our own: for people who want to look, and scripted ones for virtual time.

Belongs here: the other end of the wire, as a stranger would write it. Not: pictures of what they read (looking).

May import: `process`, `transports`, `protocols`.
"""
