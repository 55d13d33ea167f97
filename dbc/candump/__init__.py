"""candump's log format: grammar, reader, writer."""
