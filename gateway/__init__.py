"""The gateway: a pure core `step(frames, now) -> frames` and the drivers around it."""
