"""The world: motors, wheels, rail, heat, sensors and inverter ECUs. Seeded, no clock."""
