"""Filters, evaluations, callbacks and reports, which ahnn references only from YAML."""
