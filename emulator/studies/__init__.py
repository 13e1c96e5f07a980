"""Studies: reports that recompute, compare and draw. One module a study; `report` writes them.

Belongs here: what is put together for a reader. Not: physics (physics), measuring (sensing).

May import: `judging` (the sweep of each device), `sensing`, `casting`, `physics` and below.
"""
