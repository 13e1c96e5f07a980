"""What is expected of a run and whether it held: trials in virtual time, `lidaremu test`, the pytest fixture.

Belongs here: verdicts. Not: values of a run's names (instrument.series), which names there are (scenario.quantities).

May import: `runtime` and below.
"""
