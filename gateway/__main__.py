"""`python -m gateway` is `traction-gateway`."""

from gateway.cli import program

if __name__ == "__main__":
    program()
