"""A package that extends ahnn in seven places."""
