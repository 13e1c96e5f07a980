"""Gaussian beams on flat polygons: the share of the power that falls on one, and where its middle is.

Belongs here: polygons in the beam's own coordinates (u, v), see `beams`; exact sums over edges. Not: which surfaces
these are and what they send back.

Power density is 2/pi exp(-2 (u^2 + v^2)). A polygon is the signed sum of the triangles between the axis and each of its
edges; that of one with its edge from s0 to s1 on a line at the distance d is an angle less two of Owen's T (Owen 1956,
Tables for computing bivariate normal probabilities). The first moment is an integral around the polygon (Green).
"""

from __future__ import annotations

import ctypes
from functools import cache
from types import ModuleType

import numpy as np
from scipy import special
from scipy.special import cython_special

from emulator.compiled.pair import OTHERWISE, by_loops
from emulator.physics.arrays import Bools, Floats

OWENS_T = b"double (double, double, int __pyx_skip_dispatch)"
"What scipy's is as a function that loops can call."
NEAR = 1e-3
"Triangles that reach behind the pupil are cut off at this part of their greatest distance."


@cache
def _owens_t() -> int:
    """Address of scipy's function of two numbers, which loops call as arrays do; 0: this scipy has none."""
    known = getattr(cython_special, "__pyx_capi__", {})
    capsule = next((one for name, one in known.items() if name.endswith("owens_t")), None)
    if capsule is None:
        return 0
    api = ctypes.pythonapi
    api.PyCapsule_GetName.restype, api.PyCapsule_GetName.argtypes = ctypes.c_char_p, [ctypes.py_object]
    name, pointer = api.PyCapsule_GetName(capsule), api.PyCapsule_GetPointer
    pointer.restype, pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    return int(pointer(capsule, name)) if name == OWENS_T else 0


def _share_by_loops(loops: ModuleType, corner: Floats) -> tuple[Floats, Floats]:
    function = _owens_t()
    found: tuple[Floats, Floats] = loops.shares(function, corner) if function else OTHERWISE
    return found


@by_loops(_share_by_loops, "shares")
@np.errstate(under="ignore")
def gaussian_share(corner: Floats) -> tuple[Floats, Floats]:
    """Share of the power on each of k polygons (k, e, 2), and the middle (k, 2) of that light, within the polygon."""
    way = np.roll(corner, -1, axis=1) - corner
    length = np.sqrt(way[:, :, 0] ** 2 + way[:, :, 1] ** 2)
    along = way / np.maximum(length, 1e-300)[:, :, None]
    offset = corner[:, :, 0] * along[:, :, 1] - corner[:, :, 1] * along[:, :, 0]
    begin = corner[:, :, 0] * along[:, :, 0] + corner[:, :, 1] * along[:, :, 1]
    ends = np.stack([begin, begin + length])
    away = np.maximum(np.abs(offset), 1e-12)
    slope = ends / away
    turn = np.arctan(slope) / (2.0 * np.pi) - special.owens_t(2.0 * away, slope)
    signed = (np.sign(offset) * (turn[1] - turn[0])).sum(axis=1)
    # on the side of zero where the tails are small, so that their difference keeps its digits
    side = np.where(begin > 0.0, -2.0, 2.0)
    tails = special.ndtr(side * ends)
    light = np.exp(-2.0 * offset**2) * np.where(begin > 0.0, tails[0] - tails[1], tails[1] - tails[0])
    moment = np.stack([-(along[:, :, 1] * light).sum(axis=1), (along[:, :, 0] * light).sum(axis=1)], axis=1)
    moment *= 1.0 / np.sqrt(8.0 * np.pi)
    middle = moment / np.where(signed == 0.0, 1.0, signed)[:, None]
    lost = ~within(corner, middle[:, None])[:, 0]  # of what is so small or so far out that no digit is left
    middle[lost] = corner[lost].mean(axis=1)
    return np.abs(signed), middle


@np.errstate(under="ignore")
def within(corner: Floats, place: Floats) -> Bools:
    """(k, m) which of the places (k or 1, m, 2) lie in convex polygons (k, e, 2)."""
    u, v = place[:, :, 0], place[:, :, 1]
    inner = np.ones((len(corner), place.shape[1]), bool)
    outer = inner.copy()
    count = corner.shape[1]
    for k in range(count):
        a, b = corner[:, k], corner[:, (k + 1) % count]
        side = (b[:, :1] - a[:, :1]) * (v - a[:, 1:]) - (b[:, 1:] - a[:, 1:]) * (u - a[:, :1])
        inner &= side >= 0.0
        outer &= side <= 0.0
    return np.asarray(inner | outer)


@np.errstate(under="ignore")
def offset_of(corner: Floats) -> Floats:
    """(k,) least distances of convex polygons (k, e, 2) from the axis; 0 of those around it."""
    way = np.roll(corner, -1, axis=1) - corner
    square = np.maximum((way * way).sum(axis=2), 1e-300)
    part = np.minimum(np.maximum(-(corner * way).sum(axis=2) / square, 0.0), 1.0)
    foot = corner + part[:, :, None] * way
    least = np.sqrt((foot * foot).sum(axis=2).min(axis=1))
    return np.where(within(corner, np.zeros((1, 1, 2)))[:, 0], 0.0, least)


def before_pupil(corner_m: Floats) -> Floats:
    """What of triangles (k, 3, 3), z along the axis, lies before the pupil: (k, 3 or 6, 3), some corners twice."""
    z = corner_m[:, :, 2]
    least = NEAR * z.max(axis=1)
    if bool((z.min(axis=1) >= least).all()):
        return corner_m
    end = np.roll(corner_m, -1, axis=1)
    drop = end[:, :, 2] - z
    cut = np.clip((least[:, None] - z) / np.where(drop == 0.0, 1.0, drop), 0.0, 1.0)[:, :, None]
    place = corner_m + cut * (end - corner_m)
    behind, ends_behind = (z < least[:, None])[:, :, None], (end[:, :, 2] < least[:, None])[:, :, None]
    first, last = np.where(behind, place, corner_m), np.where(ends_behind, place, end)
    nowhere = (behind & ends_behind)[:, :, 0]  # one edge at the most: it shrinks to where the one before it ends
    first, last = (np.where(nowhere[:, :, None], np.roll(last, 1, axis=1), one) for one in (first, last))
    return np.stack([first, last], axis=2).reshape(-1, 6, 3)
