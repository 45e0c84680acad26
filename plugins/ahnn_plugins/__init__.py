"""Evaluation plugins and callbacks of ahnn, named only in YAML."""
