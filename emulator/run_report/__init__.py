"""`lidaremu report`: a recording added up in one pass, against the recorded scene's true ranges.

Belongs here: figures of one recording. Not: reading it (recording), how reports look (studies.report).

May import: `studies` (report, drawing), `recording`, `casting` (truth) and below.
"""
