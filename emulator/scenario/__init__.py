"""Facts of a run: files to frozen models, every error reported as `file:line: key: found; want allowed`.

Belongs here: tables, references between them, the names that expressions may have. Not: meshes' contents (world),
what is done with any of it.

May import: `faults`, `sensors`, `physics`, `config`, `transports` (texts of links), `protocols`.
"""
