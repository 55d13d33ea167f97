"""Conversion of recordings from one format to another, and shrinking of logs."""
