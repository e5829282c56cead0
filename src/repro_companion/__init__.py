"""The book's own code: it runs the notebooks, compares their tables and builds the site."""
