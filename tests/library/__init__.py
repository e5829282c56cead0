"""Tests of the library. A package, because tests of the first edition have files of the same names."""
