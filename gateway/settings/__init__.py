"""Configuration, calibration and their signatures."""
