"""Implementation of the commands on plain values, independent of command line and configuration.

`cli` builds one immutable value per job from a configuration; the functions here receive only that value.
"""
