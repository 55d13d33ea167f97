"""What the monitors show, without a screen."""
