"""Thermal faults of traction motors: paper `thermal`, its rivals, and the product's own method.

All of them read a `record`. The paper's method: `sigma_mixed` (the filter, with
`gaussian_mixture.c`), `degradation` (jump diffusion), `maisd_method` (Algorithms 1 and 2). Rivals:
`rivals`. The product's: `model` (a calibrated thermal model) and `hypotheses` (which fault explains
its residual).
"""
