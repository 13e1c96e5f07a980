"""Studies: reports that recompute, compare and draw. One module a study, `report` writes them,
`commands.study` starts them.

Belongs here: what is put together for a reader. Not: physics (physics), measuring (sensing).
"""
