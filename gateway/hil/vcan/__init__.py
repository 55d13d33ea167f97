"""Commands with real SocketCAN: in a network namespace, or in user-mode-linux.

`ways`: which of the two this machine supports; `links`: the interfaces, as shell lines; `slcan`: a
serial adapter, whose link has error states; `job`: runs a command in one of the two; `guest`: the
first process of user-mode-linux, and a library that it may need.
"""
