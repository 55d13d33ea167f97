"""Models of the motors."""
