"""A run: how it is put together, the sending process, virtual time, orders, what it shows, replay.

Belongs here: all sensors of a run on one clock. Not: one sensor (instrument), what is expected of a run (judging).

May import: `injection`, `recording`, `instrument` and below.
"""
