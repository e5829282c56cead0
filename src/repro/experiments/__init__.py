"""The experiments of the papers: frozen settings to tidy tables of results."""
