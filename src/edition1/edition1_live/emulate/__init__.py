"""An emulated board, its faults and what it plays."""
