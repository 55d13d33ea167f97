"""Measurements: `make bench`. Never asserted in tests; timings as ratios within one run."""
