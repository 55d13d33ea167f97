"""Commands where SocketCAN is real: a network namespace, or a kernel that runs as a program.

`ways`: which of the two this machine can do; `links`: the interfaces, as lines of a shell; `slcan`:
a serial adapter, whose link has error states; `job`: a command there; `guest`: what the kernel that
is a program (user-mode-linux) starts with.
"""
