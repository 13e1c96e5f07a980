"""Object lists from what the beams hit: segmentation, boxes, classes, tracks; their fit to the truth (metrics).

Belongs here: the way from scans to `DetectedObject`, as functions and classes over arrays. Not: who scans, who sends.

    tracker = ObjectTracker(TrackerOptions(coast_s=0.5), actors=scene.actors)
    objects = tracker.update([View(scan)], t_s=1.25)

May import: `sensing` (sweeps, faults of a sweep), `measuring`, `world`, `scenario` and below.
"""
