"""Recordings of runs: one folder with `run.mcap`, what other tools read beside it, and the scenario as run.

layout (what stands in the file), writer, reader (also of others' recordings), pcapng, can_logs, compare, playback.
"""
