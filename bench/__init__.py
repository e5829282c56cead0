"""What is run by hand: sizes, mutants, and what takes long."""
