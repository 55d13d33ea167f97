"""Reproduction of both papers, and evaluation: not needed to run on a bus."""
