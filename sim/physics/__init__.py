"""Motors, wheels, rail and heat: no bits, no estimator."""
