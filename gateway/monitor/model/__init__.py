"""The contents of the monitor's displays, independent of a screen."""
