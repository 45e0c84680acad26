"""Flows held against measurements: paths with their derivatives, and the unknown starts that fit them best.

Training eliminates the starts, an evaluation without truth asks how well they fit.
"""
