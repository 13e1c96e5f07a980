"""A world that somebody else moves: samples of poses from outside, and where things are at any instant.

Belongs here: samples and what is wrong with them, the feeder's clock, tracks of poses, formats of feeds, a client. Not:
bodies (world), who measures and when (runtime), the table `live:` (scenario). Nothing here reads a clock.

May import: numpy, `config`, `errors`.
"""
