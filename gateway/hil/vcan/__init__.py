"""Commands with real SocketCAN: in a network namespace, or in user-mode-linux.

`ways`: which of the two this machine can do; `links`: the interfaces, as lines of a shell; `slcan`:
a serial adapter, whose link has error states; `job`: a command there; `guest`: what the kernel that
is a program (user-mode-linux) starts with.
"""
