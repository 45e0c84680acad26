"""Evaluation plugins and callbacks of ahnn, referenced only from YAML."""
