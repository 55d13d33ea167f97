"""The core: frames in, flags out; every order of a tick stands in `tick.c`."""
