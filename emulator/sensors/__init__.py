"""Models of sensors: one YAML file a model, every number with value, source and evidence; `spec` reads them.

Belongs here: facts of a model, and the choices of how it is computed (physics_options). Not: facts of a run
(scenario).

May import: `config`.
"""
