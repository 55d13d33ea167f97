"""Logs of CAN frames in the formats of others: read into blocks; what cannot be read is counted."""
