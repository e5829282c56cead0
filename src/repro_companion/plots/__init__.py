"""Figures of the pages, a module for each paper and one for what is beyond them; :mod:`.style` is the look of all."""
