"""Data, settings and simulated rigs of each paper."""
