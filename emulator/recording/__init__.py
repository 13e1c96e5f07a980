"""Recordings of runs: writing, reading, comparing; captures, CAN logs, digests. Not: replay (runtime.playback).

Belongs here: files on the disk and the watchers that fill them. A reader believes nothing of a file.

May import: `instrument`, `scenario`, `world` (none of it), `transports` and below.
"""
