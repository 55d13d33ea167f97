"""The core: frames in, flags out; `tick.c` has the order of everything in a tick."""
