"""The live page in a browser: `lidaremu view`. A process of its own, so that it cannot slow the daemon.

frames (what is shown), live and recorded (where it comes from), points, solids and drawing (how it looks), access (who
may come in), page and controls (what the user sees and presses). viser and websockets are imported here alone.

May import: `looking` (hosts for guests), `runtime` (orders, what a run shows), `recording`, `world`, `hosts` and
below.
"""
