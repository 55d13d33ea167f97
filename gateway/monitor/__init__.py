"""The live view: an observer of the bus or of a log, and the forms in which it is shown."""
