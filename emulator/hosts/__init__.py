"""Hosts of our own: they connect to a device, ours or a real one, and read its scans. For `look` and `demo`."""
