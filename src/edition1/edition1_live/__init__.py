"""A board on a wire: its formats, recorder, live view, emulator and calibration at the board."""
