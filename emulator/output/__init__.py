"""Text output: terminal and CSV tables; untrusted characters are escaped on both.

Belongs here: how a text is shown whatever it says. Not: what is said (commands, studies, view).

May import: `emulator.errors`, nothing else of the project.
"""
