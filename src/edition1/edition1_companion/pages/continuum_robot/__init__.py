"""Page: filter and smoother on a real robot."""
