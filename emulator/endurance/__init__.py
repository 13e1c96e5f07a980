"""Long runs: soak tests with misbehaving hosts, accounts of every scan, and fuzzing of files, hosts and sessions.

Belongs here: what takes hours, or finds what nobody thought of. Not: tests of single behaviours (tests/).

May import: `runtime` and below.
"""
