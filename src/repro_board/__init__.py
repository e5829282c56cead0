"""A board on a wire: record, watch live, export and evaluate. Empty until its parts are here."""
