"""A sensor board that is not there, with its faults."""
