"""Other makers' inverters: their signals become ours."""
