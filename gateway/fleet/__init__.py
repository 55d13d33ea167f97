"""Replay of many recordings at once."""
