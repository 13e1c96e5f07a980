"""The command line, one module per command; lists of sensors, scenarios, links (catalogue); both as pages (pages).

Belongs here: words in, lines and exit codes out. What a command needs it loads when it runs. Not: doing any of it.

May import: every room.
"""
