"""Bytes on a serial line to frames, and back."""
