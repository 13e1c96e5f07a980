"""First hits of rays on bodies that rest, move or change their shape; the only users of embreex.

Belongs here: rays in, hits out. Not: which rays there are and what comes back (sensing).

May import: `world`, `compiled`, `physics` and below.
"""
