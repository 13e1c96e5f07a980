"""Object lists from what the beams hit: segmentation, boxes, classes, tracks.

Belongs here: the way from scans to `DetectedObject`, as functions and classes over arrays. Not: who scans, who sends,
and how well the result fits the truth (`emulator.object_metrics`).

    tracker = ObjectTracker(TrackerOptions(coast_s=0.5), actors=scene.actors)
    objects = tracker.update([View(scan)], t_s=1.25)
"""

from emulator.objects.options import TrackerOptions
from emulator.objects.points import SensorMotion, View
from emulator.objects.tracker import ObjectTracker

__all__ = ["ObjectTracker", "SensorMotion", "TrackerOptions", "View"]
