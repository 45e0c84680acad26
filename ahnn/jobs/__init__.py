"""Implementation of the commands on plain values, independent of command line and configuration.

`cli` builds a job's one immutable value from a configuration, and a function here receives only that value.
"""
