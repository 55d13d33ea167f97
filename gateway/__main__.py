"""`python -m gateway` is `traction-gateway`."""

import sys
from pathlib import Path

# Python puts the current folder first: a file there may have the name of a package of ours.
if sys.path[0] == str(Path.cwd()):
    sys.path.append(sys.path.pop(0))

from gateway.cli import program

if __name__ == "__main__":
    program()
