"""Logs of CAN frames in foreign formats, read into blocks; what cannot be read is counted."""
