"""Recordings from one format to another."""
