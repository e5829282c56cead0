"""What the capabilities of the package cost."""
