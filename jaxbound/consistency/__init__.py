"""Can anything within the bounds explain a window? One file a test."""
