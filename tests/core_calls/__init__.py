"""Functions of the core that no product path calls from Python, one module for each C file."""
