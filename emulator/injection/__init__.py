"""Fault injection: when the faults of a run begin and end, what they hit, what leaves late because of them.

Belongs here: triggers, durations, counts, and the hooks by which an instrument asks. Not: what faults there are and
what each does to bytes and links (faults), to a sweep (sensing) or to a list (objects).

May import: `instrument`, `faults`, `scenario` and below.
"""
