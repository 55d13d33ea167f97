"""Thermal faults of traction motors: paper `thermal`, its rivals, and the product's own method.

`record` is what all of them look at. The paper's method: `mixture` (EM), `sigma_mixed` (the
filter), `degradation` (jump diffusion), `maisd_method` (Algorithms 1 and 2). Rivals: `rivals`. The
product's: `heat` (a calibrated thermal model) and `hypotheses` (which fault explains what it does
not).
"""
