"""Serial frames in, recordings and estimates out."""
