"""Shapes in space, as the book and the live page show them."""
