"""The book's own code: its pages, the papers' recordings, twins of their rigs, and the command `repro`."""
