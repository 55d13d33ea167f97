"""Gateway and simulator together, with expectations."""
