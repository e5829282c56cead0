"""The recorder, its files, and their export."""
