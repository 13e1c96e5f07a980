"""The built-in scenarios and their meshes, found by name from any folder."""
