"""Compiled loops, loaded once for all processes of a campaign, which are forked from the one that imports this."""

from emulator.compiled import switch

switch.kernels()
