"""Estimators: from readings to configurations."""
