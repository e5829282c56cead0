"""A port to a recording that survives whatever happens."""
