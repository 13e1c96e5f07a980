"""Pure numpy physics of the beam: no scene, no port, no clock, no randomness of its own."""
