"""Poses to readings: magnets, relations between sensors and magnets, sensor models."""
