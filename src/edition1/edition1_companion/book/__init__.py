"""The book's tools: to run a notebook, sweep over parameters, compare with print."""
