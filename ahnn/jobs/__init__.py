"""What the commands do, from plain values: no command line, no configuration, no exit code.

`cli` builds a job's one immutable value from a configuration, and a function here takes it and nothing else.
"""
