"""Both papers, their rivals, and evaluation: not needed to run on a bus."""
