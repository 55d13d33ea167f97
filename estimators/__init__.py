"""Maths over (N, .) arrays: filters, models and detectors. No bus, no clock, no logging."""
