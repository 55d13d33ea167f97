"""The only place with sockets, clocks and files of a running gateway."""
