"""First hits of rays on static, moving and deforming bodies; the only users of embreex.

Belongs here: rays in, hits out. Not: which rays there are and what comes back (sensing).

May import: `world`, `compiled`, `physics` and below.
"""
