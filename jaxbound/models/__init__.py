"""Plants: models, sensors, recordings, faults, simulation."""
