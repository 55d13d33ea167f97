"""The live view: an observer of a bus or of a log, and its displays."""
