"""Shape sensing of soft continuum robots.

The library of the second edition. It is empty for now: until its parts are here, a robot of your own is read and
tracked by ``import edition1``, the library of the first edition.
"""

__version__ = "0.1.0"
