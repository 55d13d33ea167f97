"""Mapping of other makers' inverters: their signals become those of our message set."""
