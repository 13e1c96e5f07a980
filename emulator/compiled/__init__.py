"""The steps of a sweep as loops that numba compiles, with the extra `fast`; `switch` says whether they are used.

Belongs here: loops over rays, one file for each step, the same as the arrays' to the rounding of float64; the only
users of Embree's packets. Not: the arrays (physics, casting, sensing).

May import: numpy, numba; nothing else of the project.
"""
