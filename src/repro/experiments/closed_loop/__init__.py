"""A curvature controller with an estimator in its loop."""
