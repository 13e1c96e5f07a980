"""What leaves us as text: the one way to a terminal, and tables as CSV; foreign characters are tamed on both.

Belongs here: how a text is shown whatever it says. Not: what is said (commands, studies, view).

May import: `emulator.errors`, nothing else of the project.
"""
