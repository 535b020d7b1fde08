"""Slow, independent versions of the paper's equations.

Written from the text in plain Python and numpy, sharing no code with `gcnd`: the tests compare the two stage
by stage. Where the text is silent they follow docs/choices.md.
"""
