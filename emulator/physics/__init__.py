"""Formulas over arrays, each with its source: beams, range equation, surfaces, receiver, weather, detection.

Belongs here: arrays in, arrays out, and random numbers by purpose (random_streams). Not: rays, scenes, settings.

May import: `compiled`; numpy, scipy, ruamel.yaml for the table of materials.
"""
