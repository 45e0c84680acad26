"""Families of hostile cases: each module has `cases(draw, folder)`, which yields them without end."""
