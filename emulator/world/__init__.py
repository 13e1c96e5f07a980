"""Bodies and poses: meshes, materials, motion, and where everything is at any time.

Belongs here: scenario to bodies. Not: rays (casting), what a material reflects (physics).

May import: `scenario` and below.
"""
