"""From plans to scans, in the same process or in worker processes; the conditions that go with a plan.

Belongs here: plans in, scans out, over pipes. Light: the sending process has it. Not: what a scan is made of
(sensing).

May import: `scenario` (weather), `compiled` (the switch), `process`, `protocols`.
"""
